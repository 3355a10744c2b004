"""Elements of ANSYS by number (Mechanical APDL Element Reference), and what becomes of each."""

from __future__ import annotations

from enum import IntEnum


class Routine(IntEnum):
    """Numbers of elements that are read, by the names they have in the reference."""

    COMBIN14 = 14
    MASS21 = 21
    MPC184 = 184
    SOLID45 = 45
    SOLID92 = 92
    SOLID95 = 95
    SOLID185 = 185
    SOLID186 = 186
    SOLID187 = 187
    SOLID285 = 285
    BEAM4 = 4
    LINK8 = 8
    SHELL63 = 63
    LINK180 = 180
    SHELL181 = 181
    BEAM188 = 188
    BEAM189 = 189
    SHELL281 = 281


# Nodes of the full form.
SOLIDS: dict[int, int] = {
    Routine.SOLID45: 8,
    Routine.SOLID185: 8,
    Routine.SOLID95: 20,
    Routine.SOLID186: 20,
    Routine.SOLID92: 10,
    Routine.SOLID187: 10,
    Routine.SOLID285: 4,
}
# Masses, springs and rigid beams.
HANGING = (Routine.MASS21, Routine.COMBIN14, Routine.MPC184)
# They have neither stiffness nor mass of a structure: meshing facets, and surfaces that carry loads.
CARRIERS = (152, 153, 154, 200, 201)
# Contact and its targets.
CONTACT = range(169, 179)
FAMILIES: dict[str, tuple[int, ...]] = {
    "SOLID": (*SOLIDS, 70, 72, 73, 87, 90),
    "SHELL": (43, 63, 93, 181, 281),
    "BEAM": (4, 44, 188, 189),
    "LINK": (8, 180),
    "PLANE": (42, 82, 182, 183),
    "TARGE": (169, 170),
    "CONTA": (171, 172, 173, 174, 175, 176, 177, 178),
    "MASS": (21,),
    "COMBIN": (14,),
    "COMBI": (250,),
    "MPC": (184,),
    "SOLSH": (190,),
    "PRETS": (179,),
    "SURF": (152, 153, 154),
    "MESH": (200,),
    "FOLLW": (201,),
}
NAMES = {number: f"{family}{number}" for family, numbers in FAMILIES.items() for number in numbers}


def element_name(number: int) -> str:
    """Name of an element, such as SOLID186."""
    return NAMES.get(int(number), f"element number {number}")
