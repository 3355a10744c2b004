"""What ``make release`` does between the programs that it runs."""

import gzip
import io
import tarfile

from scripts.release import example, repacked, table


def packed(names: list[str], time: float, owner: str, mode: int) -> bytes:
    """An archive with a folder and files."""
    held = io.BytesIO()
    with tarfile.open(fileobj=held, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for name in names:
            member = tarfile.TarInfo(name)
            member.mtime, member.uname, member.uid, member.mode = time, owner, len(owner), mode
            member.size = len(name)
            archive.addfile(member, io.BytesIO(name.encode()))
    return gzip.compress(held.getvalue(), mtime=int(time))


def test_an_archive_of_another_day_and_user_has_the_same_bytes() -> None:
    one = repacked(packed(["a/x.py", "a/run"], 1.7e9 + 0.25, "anna", 0o775), 1000)
    other = repacked(packed(["a/run", "a/x.py"], 1.8e9 + 0.75, "bertha", 0o755), 1000)
    assert one == other
    with tarfile.open(fileobj=io.BytesIO(one)) as archive:
        members = {member.name: member for member in archive}
        assert list(members) == ["a/run", "a/x.py"]
        assert all(member.mtime == 1000 and member.uname == "" and member.mode == 0o755 for member in archive)
        assert archive.extractfile(members["a/x.py"]).read() == b"a/x.py"


def test_files_that_do_not_run_are_stored_as_such() -> None:
    with tarfile.open(fileobj=io.BytesIO(repacked(packed(["x"], 5, "", 0o664), 1000))) as archive:
        assert archive.getmember("x").mode == 0o644


def test_packages_are_listed_from_the_largest_to_the_smallest() -> None:
    lines = table([("small", "1.0", "MIT", 400_000), ("large", "2.0", "BSD", 2_000_000)]).splitlines()
    assert lines[2:] == ["| large | 2.0 | BSD | 2.0 |", "| small | 1.0 | MIT | 0.4 |", "| all 2 | | | 2 |"]


def test_the_first_block_of_python_is_the_example() -> None:
    assert example("text\n```python\na = 1\n```\n```python\nb\n```\n") == "a = 1\n"
