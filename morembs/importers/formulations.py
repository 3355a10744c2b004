"""What the element types of other programs mean, where it is not what is assembled here: a warning for each.

Here every type is assembled with full integration and a consistent mass. The sizes of effects are measured: for
CalculiX 2.20 with free bars of 6 x 2 x 2 cells, straight and curved (first eight elastic frequencies), for Abaqus with
its own matrices of a block; see docs/formats.md.
"""

from __future__ import annotations

from collections.abc import Mapping

DIALECTS = ("auto", "abaqus", "calculix")
_HYBRID = "the pressure as an unknown of its own", "not measured; large where the material hardly changes its volume"
_ABAQUS = {
    "C3D4": ("a lumped mass", "frequencies of a coarse block are 0.7 to 11 % too high here"),
    "C3D8": (
        "B-bar (the mean volume strain) and a lumped mass",
        "frequencies of a coarse block are 5.6 to 17 % too high here, the first three 7.7 to 11.5 %",
    ),
    "C3D8R": (
        "one point with hourglass stiffness and a lumped mass",
        "not measured; -9 to +14 % with CalculiX's type of that name",
    ),
    "C3D8I": ("incompatible modes", "not measured; up to 16 % too high in bending with CalculiX's type of that name"),
    "C3D6": ("2 points and a lumped mass", "not measured; -8 to +2 % with CalculiX's type of that name"),
    "C3D20R": ("8 points", "not measured; up to 0.5 % with CalculiX's type of that name"),
    "C3D27R": ("14 points", "not measured"),
    "C3D10M": ("a modified formulation", "not measured"),
}
_CALCULIX = {
    "C3D8R": ("one point with hourglass stiffness", "frequencies of a coarse bar are off by -9 to +14 %, held +24 %"),
    "C3D8I": ("incompatible modes", "frequencies of a coarse held bar are 0.5 to 16 % too high here"),
    "C3D6": ("2 points", "frequencies of a coarse bar are off by -8 to +2 %"),
    "C3D20R": ("8 points", "frequencies of a coarse bar are off by up to 0.5 %"),
}
# CalculiX takes the points of the stiffness for the mass too.
_CALCULIX_MASS = {
    "C3D4": ("1 point", "0.4 to 10 % too low here"), "C3D10": ("4 points", "up to 0.5 % too low here"),
    "C3D15": ("9 points", "up to 0.6 % too low here"),
}  # fmt: skip
# Types that are the plain ones in a linear analysis.
_PLAIN = {"C3D4", "C3D10", "C3D20", "C3D27", "C3D15"}
_SAME = {"calculix": {"C3D8", "C3D10T"}, "abaqus": {"C3D10T"}}


# Keywords of one program only, and solvers that only CalculiX has.
_ABAQUS_WORDS = {"PART", "ASSEMBLY", "INSTANCE", "PREPRINT"}
_CALCULIX_WORDS = {"NODE FILE", "EL FILE"}
_CALCULIX_SOLVERS = {
    "SPOOLES", "PARDISO", "PASTIX", "TAUCS", "SGI", "MATRIXSTORAGE", "ITERATIVESCALING", "ITERATIVECHOLESKY"
}  # fmt: skip


def dialect_of(keyword: str, options: Mapping[str, str]) -> str | None:
    """The program that a keyword with its options belongs to, None where both have it."""
    if keyword in _ABAQUS_WORDS or (keyword == "OUTPUT" and {"FIELD", "HISTORY"} & set(options)):
        return "abaqus"
    if keyword in _CALCULIX_WORDS or options.get("SOLVER", "").upper().replace(" ", "") in _CALCULIX_SOLVERS:
        return "calculix"
    return None


def abaqus_warnings(counts: Mapping[str, int], dialect: str) -> tuple[list[str], list[str]]:
    """Sentences about element types of a deck (code -> count), and those that hold for the exact mass only.

    ``dialect`` "auto" is a deck that may be of either program.
    """
    whole, mass = [], []
    doubt = " (the deck does not tell which program it is for)" if dialect == "auto" else ""
    for code, count in counts.items():
        if dialect != "calculix" and (reason := _abaqus(code)):
            whole.append(_sentence(count, code, "Abaqus", *reason) + doubt)
        if dialect != "abaqus" and (reason := _calculix(code)):
            whole.append(_sentence(count, code, "CalculiX", *reason) + doubt)
        if dialect != "abaqus" and (plain := _CALCULIX_MASS.get(code.removesuffix("T"))):
            mass.append(
                f"{count} elements {code} have the exact consistent mass, for which CalculiX takes {plain[0]}: "
                f"frequencies of a coarse bar are {plain[1]}; --mass-integration reduced gives its mass{doubt}"
            )
    return whole, mass


def _abaqus(code: str) -> tuple[str, str] | None:
    known = _ABAQUS.get(code)
    if known or code in _PLAIN | _SAME["abaqus"]:
        return known
    return _HYBRID if "H" in code[3:] else ("a formulation of its own", "not measured")


def _calculix(code: str) -> tuple[str, str] | None:
    known = _CALCULIX.get(code)
    if known or code in _PLAIN | _SAME["calculix"]:
        return known
    return None if "H" in code[3:] else ("a formulation of its own, or none", "not measured")


def _sentence(count: int, name: str, program: str, theirs: str, effect: str) -> str:
    return (
        f"{count} elements {name} are assembled with full integration and consistent mass, where {program} takes "
        f"{theirs}: {effect}"
    )


def nastran_warnings(
    counts: Mapping[tuple[str, str], int], full: Mapping[str, bool], *, consistent: bool
) -> list[str]:
    """Sentences about the solids of bulk data.

    Args:
        counts: (card and node count such as "CHEXA with 8 nodes", property) -> number of elements.
        full: property -> whether its PSOLID asks for full integration (ISOP = 1 or FULL, IN = 2 or TWO where linear).
        consistent: whether PARAM COUPMASS asks for the consistent mass.
    """
    reduced: dict[str, int] = {}
    for (name, pid), count in counts.items():
        if not name.startswith("CTETRA") and not full.get(pid, False):
            reduced[name] = reduced.get(name, 0) + count
    warnings = []
    for name, count in reduced.items():
        bubble = "reduced shear and bubble functions" if name.split()[2] in ("6", "8") else "reduced shear"
        warnings.append(
            f"{count} elements {name} are assembled with full integration, where Nastran takes {bubble} unless PSOLID "
            "says otherwise (ISOP, IN): not measured; 2 to 5 % too high in bending with MYSTRAN's reduced shear"
        )
    if not consistent:
        warnings.append(
            f"{sum(counts.values())} solid elements have a consistent mass, where Nastran takes a lumped one unless "
            "PARAM COUPMASS 1 is there: not measured; frequencies of a coarse block of tetrahedra are 0.7 to 11 % "
            "higher than with the lumped mass of Abaqus"
        )
    return warnings


# SOLID185 by KEYOPT(2).
_SOLID185 = {
    0: "B-bar (the mean volume strain)", 1: "one point with hourglass stiffness", 2: "enhanced strains",
    3: "simplified enhanced strains",
}  # fmt: skip


def ansys_warnings(routine: int, keys: Mapping[int, int], shape: str, count: int) -> list[str]:
    """Sentences about ``count`` elements SOLID``routine`` with key options ``keys`` that became ``shape``."""
    theirs, effect = "", "not measured"
    if routine == 185 and shape in ("hex8", "wedge6"):
        theirs = _SOLID185.get(keys.get(2, 0), "a formulation of its own")
    elif routine == 45 and shape in ("hex8", "wedge6") and not (keys.get(1, 0) == 1 and not keys.get(2, 0)):
        theirs = "one point with hourglass stiffness" if keys.get(2, 0) else "extra displacement shapes"
    elif routine == 186 and shape in ("hex20", "wedge15") and not keys.get(2, 0):
        theirs, effect = "8 points (KEYOPT(2) = 0)", "not measured; up to 0.5 % with C3D20R of CalculiX"
    elif routine == 95 and shape == "hex20" and keys.get(11, 0):
        theirs, effect = "8 points (KEYOPT(11) = 1)", "not measured; up to 0.5 % with C3D20R of CalculiX"
    if keys.get(6, 0) and routine in (185, 186, 187):
        theirs = f"{theirs} and {_HYBRID[0]}" if theirs else _HYBRID[0]
        effect = _HYBRID[1]
    return [_sentence(count, f"SOLID{routine}", "ANSYS", theirs, effect)] if theirs else []
