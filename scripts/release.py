"""Makes what a release consists of in dist/, and tries it: sdist and wheel, bill of materials, licenses, sizes.

    python scripts/release.py [--python PYTHON ...]

- sdist and wheel are built twice from the last commit; another byte is an error. twine checks both.
- For each PYTHON (this one without any) the wheel goes by plain pip into a fresh environment, in a folder with a space
  and an umlaut in its name; there ``morembs solvers``, the example job and the Python example of README run.
- The recipe for conda-forge is rendered by rattler-build.
- dist/morembs-VERSION.cdx.json (CycloneDX) and dist/packages-VERSION.md list the packages of the first environment.

Needs build, twine, cyclonedx-bom and py-rattler-build (``make release`` installs them).
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
# Lists name, version, license and bytes of every package of the environment that runs it.
PACKAGES = """
import importlib.metadata as metadata, json, os
def license_of(meta):
    words = [c.rpartition(' :: ')[2] for c in meta.get_all('Classifier') or [] if c.startswith('License ::')]
    words = [word for word in words if word != 'OSI Approved']
    return meta.get('License-Expression') or ', '.join(words) or (meta.get('License') or 'not stated').splitlines()[0]
def size_of(package):
    paths = [package.locate_file(file) for file in package.files or []]
    return sum(os.path.getsize(path) for path in paths if os.path.isfile(path))
print(json.dumps([(p.name, p.version, license_of(p.metadata), size_of(p)) for p in metadata.distributions()]))
"""


def run(arguments: Sequence[str | Path], folder: Path, **environment: str) -> str:
    """Run a program without the sources in its way; what it prints."""
    own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    ended = subprocess.run(
        [str(part) for part in arguments],
        cwd=folder,
        env={**own, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if ended.returncode:
        raise SystemExit(f"{' '.join(map(str, arguments))} ended with {ended.returncode}:\n{ended.stdout[-3000:]}")
    return ended.stdout


def build(folder: Path, stamp: str) -> list[Path]:
    """sdist and wheel of the last commit, of whose time all their files are."""
    run(["git", "clone", "--quiet", ROOT, folder / "sources"], ROOT)
    run([sys.executable, "-m", "build", "--outdir", folder / "dist", "."], folder / "sources", SOURCE_DATE_EPOCH=stamp)
    for sdist in (folder / "dist").glob("*.tar.gz"):
        sdist.write_bytes(repacked(sdist.read_bytes(), int(stamp)))
    return sorted((folder / "dist").iterdir())


def repacked(archive: bytes, stamp: int) -> bytes:
    """A .tar.gz with the same files, in order, without owners, all of one time."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=io.BytesIO(archive)) as old, tarfile.open(fileobj=packed, mode="w") as new:
        for member in sorted(old.getmembers(), key=lambda member: member.name):
            file = old.extractfile(member) if member.isfile() else None
            member.mtime, member.uid, member.gid, member.uname, member.gname = stamp, 0, 0, "", ""
            # Times finer than a second are in headers of their own.
            member.pax_headers = {}
            member.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
            new.addfile(member, file)
    return gzip.compress(packed.getvalue(), compresslevel=9, mtime=0)


def example(page: str) -> str:
    """The first block of Python of a page."""
    block = re.search(r"```python\n(.*?)```", page, re.DOTALL)
    if block is None:
        raise SystemExit("README.md has no block of Python to try")
    return block[1]


def try_wheel(wheel: Path, python: str, folder: Path) -> Path:
    """Install ``wheel`` and run its examples; the interpreter of the environment."""
    start = time.perf_counter()
    run([python, "-m", "venv", folder / "environment"], folder)
    own = folder / "environment" / ("Scripts" if os.name == "nt" else "bin")
    run([own / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", wheel], folder)
    installed = time.perf_counter() - start
    solvers = run([own / "morembs", "solvers"], folder)
    if "mumps" not in solvers:
        raise SystemExit(f"{python}: morembs solvers does not name mumps:\n{solvers}")
    run([own / "morembs", "init", "--example"], folder)
    run([own / "morembs", "reduce", "rod.toml"], folder, MPLBACKEND="agg")
    run([own / "morembs", "info", "rod.h5"], folder)
    run([own / "python", "-c", example((ROOT / "README.md").read_text(encoding="utf-8"))], folder)
    run([own / "morembs", "info", "conrod.h5"], folder)
    version = run([own / "python", "--version"], folder).strip()
    print(f"{version}: installed in {installed:.0f} s, examples ran in {time.perf_counter() - start - installed:.0f} s")
    return own / "python"


def render_recipe(version: str) -> None:
    """Render the recipe for conda-forge, which takes the sdist in dist/."""
    code = (
        "import sys, rattler_build as rb; [one] = rb.Stage0Recipe.from_file(sys.argv[1]).render();"
        "print(one.recipe.to_dict())"
    )
    rendered = run([sys.executable, "-c", code, ROOT / "conda" / "recipe" / "recipe.yaml"], ROOT)
    if f"'path': '../../dist/morembs-{version}.tar.gz'" not in rendered:
        raise SystemExit(f"the recipe takes another sdist than that of {version}: {rendered}")
    print("recipe rendered")


def list_packages(python: Path, version: str) -> None:
    """Write the bill of materials and the table of packages of an environment."""
    bill = DIST / f"morembs-{version}.cdx.json"
    module = ["-m", "cyclonedx_py", "environment", "--output-reproducible", "--validate", "--pyproject"]
    run([sys.executable, *module, ROOT / "pyproject.toml", "-o", bill, python], ROOT)
    rows = json.loads(run([python, "-c", PACKAGES], ROOT))
    (DIST / f"packages-{version}.md").write_text(table(rows), encoding="utf-8")
    print(f"{len(rows)} packages of {sum(row[3] for row in rows) / 1e6:.0f} MB")


def table(rows: Sequence[tuple[str, str, str, int]]) -> str:
    """Name, version, license and bytes of packages in Markdown, the largest first."""
    ordered = sorted(rows, key=lambda row: (-row[3], row[0]))
    lines = [f"| {name} | {number} | {license} | {size / 1e6:.1f} |" for name, number, license, size in ordered]
    total = sum(row[3] for row in rows) / 1e6
    head = ["| package | version | license | MB |", "|---|---|---|---|"]
    return "\n".join([*head, *lines, f"| all {len(rows)} | | | {total:.0f} |"]) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", nargs="+", default=[sys.executable], help="interpreters that the wheel is tried on")
    given = parser.parse_args(arguments)
    stamp = run(["git", "log", "-1", "--format=%ct"], ROOT).strip()
    with tempfile.TemporaryDirectory(prefix="release-") as temporary:
        folder = Path(temporary)
        both = [build(folder / name, stamp) for name in ("first", "second")]
        for first, second in zip(*both, strict=True):
            if first.read_bytes() != second.read_bytes():
                raise SystemExit(f"{first.name} has other bytes when it is built again")
        run([sys.executable, "-m", "twine", "check", "--strict", *both[0]], folder)
        DIST.mkdir(exist_ok=True)
        for path in both[0]:
            shutil.copyfile(path, DIST / path.name)
            print(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}, {path.stat().st_size / 1e6:.2f} MB")
        wheel = next(DIST / path.name for path in both[0] if path.suffix == ".whl")
        render_recipe(wheel.name.split("-")[1])
        for number, python in enumerate(given.python):
            place = folder / f"ein Ordner für {number}"
            place.mkdir()
            own = try_wheel(wheel, python, place)
            if number == 0:
                list_packages(own, wheel.name.split("-")[1])
    return 0


if __name__ == "__main__":
    sys.exit(main())
