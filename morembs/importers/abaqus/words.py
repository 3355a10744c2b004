"""Keywords of Abaqus and CalculiX by what becomes of them in a linear model."""

from __future__ import annotations

from dataclasses import dataclass

# Sources. A keyword of Abaqus has a line of a manual, or none where nobody has looked it up, which an import warns of.
_GUIDE = "Abaqus Keywords Guide, page of the keyword: "
_CARDS = "Altair HyperWorks Reference, cards of Abaqus: "
_HOURGLASS = "Abaqus Analysis User's Guide, nondefault values for the hourglass stiffness factors"
_MANUAL = "CalculiX CrunchiX User's Manual, page of the keyword"
# The matrices that ccx 2.20 stores are the same without these keywords, which a test compares.
COMPARED = _MANUAL + "; the matrices of ccx are the same without it"

# What a model loses by the keywords of a class; the notes of an import end with it.
EFFECTS = {
    "support": "supports are not applied, so the model is free: hold it by [[interface]] of a job, or import it held "
    "with --engine calculix --boundary keep",
    "load": "loads are not applied, as forces act in the simulation; [preload] of a job, or --engine calculix "
    "--preload N, stiffens by them",
    "step": "steps are not applied",
    "start": "states at the begin are not applied: materials have no temperature and no stress",
    "contact property": "they say how surfaces in contact act on each other; --contact says what becomes of contact",
    "section": "they belong to elements other than solids",
    "heat": "they carry heat, which no stiffness depends on",
    "output": "they ask for output",
    "analysis": "they steer an analysis or its numbers",
}
# Left out without a note: titles and tables that other keywords name.
SILENT = ("HEADING", "PREPRINT", "TIME POINTS", "NO ANALYSIS", "DISTRIBUTION", "DISTRIBUTION TABLE", "VIEWFACTOR")


@dataclass(frozen=True)
class Word:
    """What becomes of a keyword: its class ``kind``, and the ``source`` that nothing of K and M depends on it (of
    classes with an entry in ``EFFECTS``; "": there is none, which an import warns of)."""

    kind: str
    source: str = ""


# fmt: off
_TABLE = (
    ("material", "", """
        ELASTIC, DENSITY, EXPANSION, CONDUCTIVITY, SPECIFIC HEAT, LATENT HEAT, PLASTIC, DAMPING, CREEP,
        CYCLIC HARDENING, RATE DEPENDENT, POTENTIAL, DEPVAR, HYPERELASTIC, HYPERFOAM, VISCOELASTIC, USER MATERIAL,
        ELECTRICAL CONDUCTIVITY, FAIL STRESS, FAIL STRAIN, DEFORMATION PLASTICITY, NO TENSION, NO COMPRESSION,
        FLUID CONSTANTS, MAGNETIC PERMEABILITY, USER DEFINED FIELD, PERMEABILITY, TENSILE FAILURE, SHEAR FAILURE,
        DAMAGE INITIATION, DAMAGE EVOLUTION, DAMAGE STABILIZATION, CRUSHABLE FOAM, CRUSHABLE FOAM HARDENING,
        CONCRETE, CONCRETE DAMAGED PLASTICITY, CONCRETE COMPRESSION HARDENING, CONCRETE TENSION STIFFENING,
        CONCRETE COMPRESSION DAMAGE, CONCRETE TENSION DAMAGE, TENSION STIFFENING, SHEAR RETENTION, FAILURE RATIOS,
        DRUCKER PRAGER, DRUCKER PRAGER HARDENING, DRUCKER PRAGER CREEP, MOHR COULOMB, MOHR COULOMB HARDENING,
        CAP PLASTICITY, CAP HARDENING, CAST IRON PLASTICITY, CAST IRON COMPRESSION HARDENING,
        CAST IRON TENSION HARDENING, SWELLING, VISCOUS, ANNEAL TEMPERATURE, INELASTIC HEAT FRACTION,
        JOULE HEAT FRACTION, DIFFUSIVITY, SOLUBILITY, PIEZOELECTRIC, DIELECTRIC, EOS, HYPOELASTIC, POROUS ELASTIC,
        CLAY PLASTICITY, CLAY HARDENING, POROUS METAL PLASTICITY, VOID NUCLEATION, ORNL, MULLINS EFFECT, HYSTERESIS,
        UNIAXIAL TEST DATA, BIAXIAL TEST DATA, PLANAR TEST DATA, VOLUMETRIC TEST DATA, SIMPLE SHEAR TEST DATA,
        LOW DENSITY FOAM, SUPERELASTIC, SUPERELASTIC HARDENING, USER OUTPUT VARIABLES, HEAT GENERATION,
        MOISTURE SWELLING, SORPTION, GEL, POROUS BULK MODULI, PRESSURE DEPENDENCE, TRS, SHEAR TEST DATA,
        COMBINED TEST DATA, ACOUSTIC MEDIUM, SPECIFIC GAS CONSTANT, MATERIAL DAMPING, MODEL CHANGE DEFINITION,
        REGULARIZE, FABRIC, BRITTLE CRACKING, BRITTLE SHEAR, BRITTLE FAILURE, JOINTED MATERIAL, SOFT ROCK HARDENING"""),
    ("support", _MANUAL, "BOUNDARY, BASE MOTION, SUBMODEL"),
    ("load", _MANUAL, "CLOAD, DLOAD, DSLOAD, TEMPERATURE, CFLUX, DFLUX"),
    ("load", "", "DSFLUX, FIELD, INCIDENT WAVE INTERACTION PROPERTY, CORRELATION, PSD-DEFINITION, SPECTRUM"),
    ("start", COMPARED, "INITIAL CONDITIONS"),
    ("step", _MANUAL, """
        STATIC, CHANGE FRICTION, CHANGE SURFACE BEHAVIOR, CHANGE MATERIAL, SENSITIVITY, FEASIBLE DIRECTION,
        ROBUST DESIGN, NO ANALYSIS, VIEWFACTOR, CRACK PROPAGATION, RETAINED NODAL DOFS, RANDOM FIELD,
        CORRELATION LENGTH, GEOMETRIC TOLERANCES, OBJECTIVE, CONSTRAINT, FILTER"""),
    ("step", "", "CHANGE CONTACT TYPE, CO-SIMULATION, SUBSTRUCTURE LOAD CASE"),
    ("contact property", COMPARED, """
        SURFACE INTERACTION, SURFACE BEHAVIOR, FRICTION, CONTACT DAMPING, CLEARANCE, GAP CONDUCTANCE,
        GAP HEAT GENERATION"""),
    ("contact property", "", """
        GAP RADIATION, CONTACT INTERFERENCE, CONTACT INCLUSIONS, CONTACT EXCLUSIONS, SURFACE PROPERTY ASSIGNMENT,
        CONTACT CONTROLS ASSIGNMENT, CONTACT FORMULATION"""),
    ("heat", COMPARED, "FILM, RADIATE, PHYSICAL CONSTANTS"),
    ("heat", "", "SFILM, SRADIATE, CAVITY DEFINITION, EMISSIVITY, SURFACE PROPERTY, RADIATION VIEWFACTOR"),
    ("output", COMPARED, """
        OUTPUT, NODE PRINT, NODE FILE, NODE OUTPUT, EL PRINT, EL FILE, ELEMENT OUTPUT, CONTACT PRINT, CONTACT FILE,
        CONTACT OUTPUT, SECTION PRINT, RESTART, TIME POINTS, HEADING"""),
    ("output", "", """
        FILE FORMAT, ENERGY PRINT, ENERGY FILE, ENERGY OUTPUT, MONITOR, INTEGRATED OUTPUT, INTEGRATED OUTPUT SECTION,
        RADIATION FILE, RADIATION PRINT, RADIATION OUTPUT, PRINT, SECTION FILE, MODAL FILE, MODAL PRINT,
        TRACER PARTICLE, DIAGNOSTICS"""),
    ("analysis", COMPARED, """
        AMPLITUDE, CONTROLS, DESIGN VARIABLES, DISTRIBUTION, DISTRIBUTION TABLE, VALUES AT INFINITY"""),
    ("analysis", "", """
        EXTREME VALUE, EXTREME ELEMENT VALUE, ADAPTIVE MESH CONTROLS, CONSTRAINT CONTROLS, BULK VISCOSITY,
        PARAMETER DEPENDENCE, NODAL ENERGY RATE"""),
    ("section", _MANUAL, """
        SHELL SECTION, BEAM SECTION, BEAM GENERAL SECTION, MEMBRANE SECTION, GAP, FLUID SECTION, USER ELEMENT,
        USER SECTION, NODAL THICKNESS, NORMAL"""),
    ("section", "", """
        FRAME SECTION, GASKET SECTION, COHESIVE SECTION, CONNECTOR DAMPING, CONNECTOR FRICTION, CONNECTOR STOP,
        CONNECTOR LOCK, CONNECTOR CONSTITUTIVE REFERENCE, CONNECTOR PLASTICITY, CONNECTOR HARDENING,
        CONNECTOR MOTION, INTERFACE, ACOUSTIC FLOW VELOCITY, EULERIAN SECTION, JOINT, JOINT ELASTICITY,
        TRANSVERSE SHEAR, SHEAR CENTER, CENTROID, UEL PROPERTY, MATRIX, GASKET BEHAVIOR, GASKET ELASTICITY,
        GASKET THICKNESS BEHAVIOR, PIPE-SOIL INTERACTION, SURFACE SECTION, TRANSVERSE SHEAR STIFFNESS, FLUID SURFACE,
        FLUID DENSITY, FLUID BULK MODULUS, FLUID EXPANSION, FLUID EXCHANGE"""),
    # Keywords of Abaqus, each with the line of a manual on it.
    ("contact property", _GUIDE + "Assign contact initialization methods", "CONTACT INITIALIZATION ASSIGNMENT"),
    ("contact property", _GUIDE + "Assign contact properties", "CONTACT PROPERTY ASSIGNMENT"),
    ("contact property", _GUIDE + "Define contact initialization methods", "CONTACT INITIALIZATION DATA"),
    ("contact property", _GUIDE + "Specify additional controls for contact", "CONTACT CONTROLS"),
    ("contact property", _GUIDE + "Define contact stabilization controls for general contact", "CONTACT STABILIZATION"),
    ("section", _GUIDE + "Specify connector attributes for connector elements", "CONNECTOR SECTION"),
    ("section", _GUIDE + "Begin the specification of a connector behavior", "CONNECTOR BEHAVIOR"),
    ("section", _GUIDE + "Define connector elastic behavior", "CONNECTOR ELASTICITY"),
    ("analysis", _GUIDE + "Specify section controls", "SECTION CONTROLS"),
    ("output", "Abaqus Analysis User's Guide, Output: the amount of information in the data file", "PREPRINT"),
    ("section", _GUIDE + "ELSET is the set of its shell elements", "SHELL GENERAL SECTION"),
    ("contact property", _CARDS + "surface-based cohesive behavior in contact", "COHESIVE BEHAVIOR"),
    ("contact property", _CARDS + "define contact clearance properties", "CONTACT CLEARANCE"),
    ("contact property", _CARDS + "assign contact clearances between surfaces", "CONTACT CLEARANCE ASSIGNMENT"),
    ("section", _CARDS + "define additional beam inertia", "BEAM ADDED INERTIA"),
    ("analysis", _HOURGLASS, "HOURGLASS STIFFNESS"),
    ("analysis", "", """
        INFINITE SECTION, MEMBRANE, FLUID LEAKAGE, MONITOR SURFACE, SYMMETRIC RESULTS, PERIODIC MEDIA, DEFAULT,
        LATIN HYPERCUBE, CONTACT STABILIZATION ASSIGNMENT, CONTACT FILE FORMAT, FLUX, VELOCITY, CRITICAL VALUE,
        MEAN TEMPERATURE, SYMMETRY, ORIENTATION NORMAL, DEBUG, FRONT, PSD DEFINITION, END"""),
    ("contact", "", "CONTACT PAIR, CONTACT"),
    ("constraint", "", "COUPLING, KINEMATIC COUPLING, DISTRIBUTING COUPLING, RIGID BODY, MPC, EQUATION, TIE"),
    ("property", "", "SOLID SECTION, MASS, ROTARY INERTIA, SPRING, DASHPOT"),
    # Words that begin or end a room of a deck.
    ("room", "", "PART, END PART, ASSEMBLY, END ASSEMBLY, INSTANCE, END INSTANCE, END STEP"),
    ("mesh", "", """
        STEP, NODE, ELEMENT, NSET, ELSET, MATERIAL, SURFACE, ORIENTATION, KINEMATIC, DISTRIBUTING, TRANSFORM,
        INCLUDE, NCOPY, ELCOPY, NFILL, NGEN, ELGEN"""),
)
# fmt: on
WHY_REFUSED = {
    "EMBEDDED ELEMENT": "embedded elements are not supported",
    "SYSTEM": "moved coordinates are not supported",
    "CYCLIC SYMMETRY MODEL": "a sector stands for a whole turn, which is another body",
    "SHELL TO SOLID COUPLING": "shells are not supported",
    "SUBSTRUCTURE PROPERTY": "substructures are not supported here; import their matrices",
    "USER MATERIAL": "its stiffness is in a program of its own",
    "PRE-TENSION SECTION": "it cuts a bolt, whose faces part along the normal by one dof, direction 1 of its node",
    "IMPERFECTION": "it moves the nodes",
    "MODEL CHANGE": "elements and contact come and go by it",
    "REBAR LAYER": "reinforcement has stiffness and mass",
    "FIXED MASS SCALING": "it changes the mass of elements",
    "VARIABLE MASS SCALING": "it changes the mass of elements",
}
# What cures a word that is refused, where it is more than to leave the word out.
CURES = {"PRE-TENSION SECTION": "--pretension locked joins the faces; --pretension cut parts them by this dof"}
# Keywords that are left out with a warning, because of an option ("": always): what a model may lose.
WARNED = {
    "HOURGLASS STIFFNESS": ("", "it changes the stiffness of elements with reduced integration"),
    "SECTION CONTROLS": ("HOURGLASS", "HOURGLASS= changes the stiffness of elements with reduced integration"),
    "SURFACE SECTION": ("DENSITY", "DENSITY= is the mass of a surface"),
}
# Elements that stand for contact.
GAPS = {"GAPUNI", "GAPCYL", "GAPSPHER", "ITSUNI", "ITSCYL"}

WORDS = {word: Word(kind, source) for kind, source, words in _TABLE for word in " ".join(words.split()).split(", ")} | {
    word: Word("refused") for word in WHY_REFUSED if word != "USER MATERIAL"
}


def of_kind(*kinds: str) -> frozenset[str]:
    """The keywords of some classes."""
    return frozenset(word for word, entry in WORDS.items() if entry.kind in kinds)


MATERIAL = of_kind("material")
CONTACT = of_kind("contact")
CONSTRAINTS = of_kind("constraint")
PROPERTIES = of_kind("property")
STRUCTURAL = of_kind("room")
# Sections of shells, membranes and beams, and what goes with them.
SECTIONS = (
    *("SHELL SECTION", "MEMBRANE SECTION", "BEAM SECTION", "BEAM GENERAL SECTION"),
    *("NODAL THICKNESS", "NORMAL"),
)
# Neither stiffness nor mass of the model depends on these.
LEFT_OUT = of_kind(*EFFECTS)
_SPELLINGS = {word.replace(" ", ""): word for word in WORDS}


# Options of two words, which are also written as one.
_OPTIONS = {
    word.replace(" ", ""): word
    for word in (
        "REF NODE",
        "ROT NODE",
        "CONSTRAINT NAME",
        "POSITION TOLERANCE",
        "INFLUENCE RADIUS",
        "WEIGHTING METHOD",
        "CYCLIC SYMMETRY",
        "TIE NSET",
        "PIN NSET",
        "ANALYTICAL SURFACE",
        "CHANGE NUMBER",
        "OLD SET",
        "NEW SET",
        "ELEMENT SHIFT",
        "SHIFT NODES",
        "TWO STEP",
    )
}


def canonical_option(name: str) -> str:
    """The name of an option in capitals as the manuals have it."""
    name = " ".join(name.upper().split())
    return _OPTIONS.get(name, name)


def canonical(word: str) -> str:
    """A keyword in capitals as the manuals have it: blanks in it do not count (*SOLIDSECTION)."""
    word = " ".join(word.upper().split())
    return word if word in WORDS else _SPELLINGS.get(word.replace(" ", ""), word)
