"""The tables and keys of a job file, with their limits. Docs, messages and the JSON schema come from the hints."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

from morembs.base.errors import InputError, nearest
from morembs.base.key_tables import Table, described
from morembs.base.limits import DampingFloor, DampingRatio, Finite, NotNegative, length, number, text
from morembs.base.tolerances import TOL as BASE
from morembs.body.floating.preload import Preload
from morembs.body.floating.spinning import Rotation
from morembs.fem.interface import COUPLINGS
from morembs.parametric.parameter import NAME as PARAMETER
from morembs.parametric.parameter import PROPERTIES
from morembs.problem.damping import modal_steps
from morembs.reducers import REDUCERS
from morembs.responses.band import Band
from morembs.responses.measures import Sharpness
from morembs.responses.tolerances import TOL as RESPONSES

Three = Annotated[list[Finite], length("three numbers", 3)]
Six = Annotated[list[Finite], length("six numbers", 6)]
CurvePoints = Annotated[int, number("an integer from 2 to 100000", ge=2, le=100_000)]
_LOWEST_HZ = RESPONSES.least_upper_hz
ResponseHertz = Annotated[
    float, number(f"a frequency in Hz from {_LOWEST_HZ:g} to {BASE.largest_hz:g}", gt=_LOWEST_HZ, lt=BASE.largest_hz)
]
# Names become groups of the HDF5 file.
SAFE_NAME = r"^[A-Za-z0-9_][A-Za-z0-9_.+-]*$"


@dataclass(frozen=True, kw_only=True)
class UnitsTable(Table):
    """Units by name."""

    length: str = described('a unit of length such as "mm"')
    mass: str = described('a unit of mass such as "t"')
    time: str = described('a unit of time such as "s"')


@dataclass(frozen=True, kw_only=True)
class ModelTable(Table):
    """``[model]``: a mesh file, or a model file; and the units of all numbers in the mesh and in the job.

    A job with tables ``[[substructure]]`` has neither; ``units`` are those of its places and springs.
    """

    mesh: Annotated[str, text('the path of a mesh file such as "conrod.msh"')] | None = None
    file: Annotated[str, text('the path of a model file of morembs import such as "conrod.model.h5"')] | None = None
    engine: Annotated[str, text('who assembles a deck that file names: "auto", "calculix" or "mystran"')] | None = None
    units: str | UnitsTable = described(
        '"length-mass-time" such as "mm-t-s", or a table with length, mass and time', "m-kg-s"
    )
    mass_integration: Literal["element", "exact", "reduced"] = "element"
    dialect: Literal["auto", "abaqus", "calculix"] = described(
        '"auto", "abaqus" or "calculix": the program that a deck .inp was written for', "auto"
    )
    allow_includes_outside: bool = described("true or false: a deck may include files from beyond its folder", False)
    unsymmetric: Literal["refuse", "split", "symmetrise"] = described(
        '"refuse", "split" or "symmetrise": what becomes of the skew parts of K and D', "refuse"
    )

    def refuse_conflicts(self) -> None:
        if self.mesh is not None and self.file is not None:
            raise InputError("mesh and file were both given; choose one")
        if self.engine is not None and self.file is None:
            raise InputError(f'engine = "{self.engine}" was given without file, the deck that it is for; give file')
        if self.file is not None and self.engine is None and "mass_integration" in self.given:
            raise InputError("mass_integration was given for a model file, whose matrices are ready; leave it out")
        deck = self.mesh or (self.file if self.engine is not None else None) or ""
        if self.dialect != "auto" and not deck.lower().endswith(".inp"):
            raise InputError(f'dialect = "{self.dialect}" was given without a deck .inp; leave it out')


@dataclass(frozen=True, kw_only=True)
class RotationTable(Table):
    """A turn about an axis."""

    axis: Three = described("a direction [x, y, z]")
    degrees: Finite


@dataclass(frozen=True, kw_only=True)
class SubstructureTable(Table):
    """``[[substructure]]``: a body that is a part of an assembly, and its place."""

    name: Annotated[str, text("a name without colons and slashes", r"^[^/:\s.\x00-\x1f][^/:\x00-\x1f]*$", longest=100)]
    body: Annotated[str, text('the path of a body file such as "link.h5"')]
    reduction: str | None = described("the body of the file, where it has several", None)
    job: Annotated[str, text('the path of the job file that made the body such as "link.toml"')] | None = None
    at: dict[str, Finite] = described("values of its parameters in SI units such as { E = 2.0e11 }", {})
    position: Three = described("[x, y, z] of the origin of its model", [0.0, 0.0, 0.0])
    rotation: RotationTable | None = described("a table { axis = [x, y, z], degrees = ... }", None)

    def refuse_conflicts(self) -> None:
        if self.job is not None and self.at:
            raise InputError("job was given beside at; a certificate against the unreduced part takes nominal values")


@dataclass(frozen=True, kw_only=True)
class CoupleTable(Table):
    """``[[couple]]``: interfaces of two substructures that move as one, or that springs connect."""

    between: Annotated[list[str], length('two interfaces such as ["upper:TIP", "lower:ROOT"]', 2)]
    components: Annotated[list[int], length("one or more", 1, sys.maxsize)] = described(
        "some of [0, 1, 2, 3, 4, 5]", [0, 1, 2, 3, 4, 5]
    )
    stiffness: Six | None = described("six numbers, zero or more: springs, instead of one motion", None)
    damping: Six | None = described("six numbers, zero or more, beside stiffness", None)


@dataclass(frozen=True, kw_only=True)
class MaterialTable(Table):
    """``[[material]]``: elastic constants and density of an element set, isotropic or orthotropic."""

    set: str = described('the name of an element set, or "all"', "all")
    young: Finite | Three = described("one number, or [E1, E2, E3] for an orthotropic material")
    poisson: Finite | Three = described("one number, or [nu12, nu13, nu23] for an orthotropic material")
    density: Finite
    shear: Three | None = described("[G12, G13, G23]", None)
    axes: Annotated[list[Three], length("three rows", 3)] | None = described(
        "three rows, the material directions 1, 2, 3 in the frame of the mesh", None
    )

    def refuse_conflicts(self) -> None:
        lists = [isinstance(self.young, list), isinstance(self.poisson, list), self.shear is not None]
        if any(lists) and not all(lists):
            raise InputError(
                "an orthotropic material needs young = [E1, E2, E3], poisson = [nu12, nu13, nu23] and "
                "shear = [G12, G13, G23]; an isotropic one needs one young, one poisson and no shear"
            )
        if self.axes is not None and not all(lists):
            raise InputError("axes was given for an isotropic material; leave it out")


@dataclass(frozen=True, kw_only=True)
class ParameterTable(Table):
    """``[[parameter]]``: what of the model varies, and between which values."""

    name: Annotated[str, text("a name of letters, digits and _", PARAMETER, longest=100)]
    property: str = described("one of " + ", ".join(repr(name) for name in PROPERTIES))
    set: str | list[str] = described(
        'an element set, a list of them, "all", or the elements in a region such as "box:0,0,0,1,1,1"', "all"
    )
    range: Annotated[list[Finite], length("[LOW, HIGH]", 2)]
    nominal: Finite | None = described("a number in the range", None)
    displacement: Annotated[str, text('the path of a table id,dx,dy,dz such as "longer.csv"')] | None = None
    mesh: Annotated[str, text("the path of the mesh at the value 1")] | None = None
    interface: str | None = described("the interface that a spring holds", None)
    to: str | None = described("another interface that it holds to, in place of the ground", None)
    stiffness: Six | None = described("six numbers, zero or more, of a spring at the value 1", None)

    def refuse_conflicts(self) -> None:
        if self.property not in PROPERTIES:
            if self.property == "speed":
                raise InputError(
                    "property = 'speed' was given; a table [spin] gives one body for all speeds, with the Coriolis "
                    "matrix that no stiffness tells"
                )
            raise InputError(f"property = {self.property!r} was given; {nearest(self.property, PROPERTIES)}")
        moves = [key for key in ("displacement", "mesh") if getattr(self, key) is not None]
        if self.property == "morph" and len(moves) != 1:
            raise InputError(f"a morph needs displacement or mesh; {' and '.join(moves) or 'neither'} was given")
        if self.property != "morph" and moves:
            raise InputError(f"{moves[0]} was given beside property = {self.property!r}; it belongs to a morph")
        springs = [key for key in ("interface", "stiffness") if getattr(self, key) is not None]
        if self.property == "spring" and (len(springs) != 2 or self.to == self.interface):
            raise InputError("a spring needs interface and stiffness = [six numbers], and to, if it has one, another")
        if self.property != "spring" and (springs or self.to is not None):
            raise InputError(
                f"{(springs or ['to'])[0]} was given beside property = {self.property!r}; it belongs to a spring"
            )
        if self.property not in ("young", "density") and "set" in self.given:
            raise InputError(f"set was given beside property = {self.property!r}; it belongs to young and density")


@dataclass(frozen=True, kw_only=True)
class InterfaceTable(Table):
    """``[[interface]]``: where other bodies touch the part."""

    name: Annotated[str, text("a name without slashes", r"^[^/\s.\x00-\x1f][^/\x00-\x1f]*$", longest=100)]
    nodes: str | None = described('a selection of nodes such as "set:BIGEND"', None)
    matrix: str | None = described(
        'in place of nodes, columns of B or rows of C such as "B:drive", "C:tip,base" or "B"', None
    )
    coupling: str = described("one of " + ", ".join(repr(name) for name in COUPLINGS.own if name != "matrix"), "rigid")
    point: Three | None = described("the origin of the interface, [x, y, z]", None)
    components: list[int] | None = described("some of [0, 1, 2, 3, 4, 5]", None)

    def refuse_conflicts(self) -> None:
        if self.nodes is None and self.matrix is None:
            raise InputError('nodes is missing; expected a selection of nodes such as "set:BIGEND"')
        if self.matrix is not None:
            beside = {"nodes", "coupling", "point", "components"} & self.given
            if beside:
                raise InputError(f"matrix and {min(beside)} were both given; columns of a matrix say all, leave it out")


@dataclass(frozen=True, kw_only=True)
class RayleighTable(Table):
    """D = alpha M + beta K, in the declared unit of time."""

    alpha: Annotated[float, number("a number, zero or more (1/time)", ge=0)] = 0.0
    beta: Annotated[float, number("a number, zero or more (time)", ge=0)] = 0.0


@dataclass(frozen=True, kw_only=True)
class DampingTable(Table):
    """``[damping]``: Rayleigh or modal damping, structural damping with either."""

    rayleigh: RayleighTable | None = described("a table { alpha = ..., beta = ... }", None)
    modal: DampingRatio | str | list[list[Finite]] | None = described(
        "a part of critical damping from 0 to 1, such as 0.02 for 2 percent, or a table [[0, ratio], "
        '[frequency_hz, ratio], ...], or the name of one such as "adams"',
        None,
    )
    structural: NotNegative | None = described("a loss factor, zero or more, for the frequency domain only", None)

    def refuse_conflicts(self) -> None:
        if isinstance(self.modal, str | list):
            modal_steps(self.modal)
        if self.rayleigh is not None and self.modal is not None:
            raise InputError("rayleigh and modal were both given; choose one")


@dataclass(frozen=True, kw_only=True)
class SolverTable(Table):
    """``[solver]``: which sparse solver, and what it may use."""

    name: str = described('"auto" or a name that "morembs solvers" lists', "auto")
    memory: str | None = described('a text such as "4 GiB" or "500 MB"', None)
    threads: Annotated[int, number("a count of threads from 1 to 4096", ge=1, le=4096)] | None = None
    scratch: Annotated[str, text("the path of a folder for temporary files")] | None = None
    out_of_core: bool = described("true to keep the factor and all arrays on disk, or false", False)
    ranks: Annotated[int, number("a count of MPI processes from 1 to 65536", ge=1, le=65536)] | None = None
    workers: Annotated[int, number("a count of processes from 1 to 1024", ge=1, le=1024)] = 1

    def refuse_conflicts(self) -> None:
        if self.ranks is not None and self.name not in ("auto", "mumps-ranks"):
            raise InputError(f'ranks was given beside name = "{self.name}"; only "mumps-ranks" takes ranks')
        if self.ranks is not None and self.workers > 1:
            raise InputError("ranks and workers were both given; choose one")


@dataclass(frozen=True, kw_only=True)
class ReduceTable(Table):
    """``[[reduce]]``: one reduced body. Further keys are the options of its method."""

    further: ClassVar[Mapping[str, Any]] = {}
    method: str = described("one of " + ", ".join(REDUCERS.own))
    name: Annotated[str, text("a name of letters, digits, _, -, + and .", SAFE_NAME, longest=100)] | None = None

    def options(self) -> dict[str, object]:
        """Keys besides name and method."""
        return dict(self.further)


@dataclass(frozen=True, kw_only=True)
class OutputTable(Table):
    """``[output]``: the body file, and a picture if one is wanted."""

    path: Annotated[str, text('the path of the body file such as "conrod.h5"')]
    nodes: Literal["all", "skin", "interfaces"] = "all"
    picture: Annotated[str, text("the path of a .png, .pdf or .svg file", r"\.(png|pdf|svg)$")] | None = None


@dataclass(frozen=True, kw_only=True)
class ResponseTable(Table):
    """``[response]``: frequency response of the full and the reduced model at logarithmic steps."""

    from_hz: ResponseHertz
    to_hz: ResponseHertz
    points: CurvePoints = 200

    def refuse_conflicts(self) -> None:
        if self.to_hz <= self.from_hz:
            raise InputError(f"from_hz = {self.from_hz:g} must lie below to_hz = {self.to_hz:g}")


@dataclass(frozen=True, kw_only=True)
class CertifyTable(Table):
    """``[certify]``: limits of the errors at every frequency of a band."""

    band_hz: Band
    points: CurvePoints = 200
    bound: bool = True
    measure: Literal["envelope", "peak", "pointwise"] = "envelope"
    damping_floor: DampingFloor | None = None
    sharpness: Sharpness = RESPONSES.sharpness


@dataclass(frozen=True, kw_only=True)
class StateSpaceTable(Table):
    """``[state_space]``: a file for control design of one body."""

    path: Annotated[str, text("the path of a .npz or .mat file", r"\.(npz|mat)$")]
    inputs: Annotated[list[str], length('inputs such as ["base:acceleration", "tip:force:z"]', 1, sys.maxsize)]
    outputs: Annotated[list[str], length('outputs such as ["base:reaction", "tip:displacement"]', 1, sys.maxsize)]
    held: list[str] = described("names of the interfaces at rest", [])
    step: Annotated[float, number("a step in s for the zero-order hold", gt=0, lt=1e12)] | None = None
    body: str | None = described("the name of a reduction", None)


@dataclass(frozen=True, kw_only=True)
class FrameTable(Table):
    """``[frame]``: how the body frame follows the body."""

    kind: Literal["mean-axes", "center-of-mass", "tangent", "chord"] = "mean-axes"
    interfaces: list[str] = described("names of the interfaces that the frame follows", [])
    origin: Three | Literal["center-of-mass"] | None = described(
        'the origin of the frame, [x, y, z] or "center-of-mass"', None
    )


@dataclass(frozen=True, kw_only=True)
class EnvelopeTable(Table):
    """``[envelope]``: the largest loads in use, in the declared units (rad for angles)."""

    acceleration: Annotated[float, number("a number, zero or more (length/time2)", ge=0)] | None = None
    angular_acceleration: Annotated[float, number("a number, zero or more (rad/time2)", ge=0)] | None = None
    speed: Annotated[float, number("a number, zero or more (rad/time)", ge=0)] | None = None
    force: NotNegative | None = None
    moment: NotNegative | None = None


@dataclass(frozen=True, kw_only=True)
class StiffeningTable(Table):
    """``[stiffening]``: geometric stiffening of every body."""

    share: Annotated[float, number("a part from 0 to below 1", ge=0, lt=1)] = described(
        "the part of the stiffness below which a term is left out, from 0 to 1", 0.01
    )


@dataclass(frozen=True, kw_only=True)
class PreloadTable(Table):
    """``[preload]``: loads in the declared units whose stress stiffens the body before it is reduced."""

    wrench: dict[str, Six] = described("a table { interface = [fx, fy, fz, mx, my, mz] }", {})
    speed: Finite = described("a number (rad/time)", 0.0)
    axis: Three | None = described("the direction of the axis of rotation, [x, y, z]", None)
    point: Three = described("a point of the axis, [x, y, z]", [0.0, 0.0, 0.0])
    acceleration: Three = described("the acceleration of the body less gravity, [x, y, z]", [0.0, 0.0, 0.0])
    held: list[str] = described("names of the interfaces that carry the loads", [])
    follows: list[str] = described("names of the interfaces that the loads turn with", [])

    def refuse_conflicts(self) -> None:
        Preload(**{**self.values(), "held": tuple(self.held), "follows": tuple(self.follows)})


@dataclass(frozen=True, kw_only=True)
class SpinTable(Table):
    """``[spin]``: matrices of a frame that turns with the body, for all speeds."""

    speed: Annotated[list[Finite], length("speeds such as [0, 100, 400] (rad/time)", 1, sys.maxsize)]
    axis: Three = described("the direction of the axis, [x, y, z]")
    point: Three = described("a point of the axis, [x, y, z]", [0.0, 0.0, 0.0])
    held: list[str] = described("names of the interfaces at rest in the frame that turns", [])
    stress: bool = described("true or false: the centrifugal stress stiffens", True)
    modes: Annotated[int, number("a count of complex modes", ge=1, le=1000)] = 12

    def refuse_conflicts(self) -> None:
        Rotation(axis=self.axis, point=self.point)


@dataclass(frozen=True, kw_only=True)
class FlowTable(Table):
    """``[[flow]]``: fluid that flows through a tube of beam elements, in the declared units."""

    path: Annotated[str, text('nodes in the order of the flow: "ids:4,7,2", "set:TUBE" or the path of a .csv')]
    mass_flow: Finite = described("a number (mass/time)")
    density: Annotated[float, number("a number above zero", gt=0)]
    area: Annotated[float, number("the area of the bore", gt=0)]
    outlet: Literal["held", "free"] = described('"held" or "free": the last node is a nozzle', "held")


@dataclass(frozen=True, kw_only=True)
class ModesTable(Table):
    """``[modes]``: what ``morembs modes`` computes of the full model."""

    kind: Literal["real", "complex"] = "real"
    count: Annotated[int, number("a count of modes", ge=1, le=1000)] = 20
    held: list[str] = described("names of the interfaces at rest, for complex modes", [])


@dataclass(frozen=True, kw_only=True)
class StressTable(Table):
    """``[stress]``: stress shapes of every body."""

    nodes: str = described('"skin", "all" or a selection such as "set:FILLET"', "skin")
    single: bool = True
    correction: bool = True
    jump: bool = True


@dataclass(frozen=True, kw_only=True)
class CheckTable(Table):
    """``[check]``: what the reduced bodies are compared with."""

    full_modes: Annotated[int, number("a count of free-free frequencies of the full model, 0 for none", ge=0)] = 10


@dataclass(frozen=True, kw_only=True)
class JobTables(Table):
    """All tables of a job file."""

    model: ModelTable = field(default_factory=ModelTable)
    substructure: list[SubstructureTable] = field(default_factory=list)
    couple: list[CoupleTable] = field(default_factory=list)
    material: list[MaterialTable] = described("at least one table [[material]]", [])
    parameter: list[ParameterTable] = field(default_factory=list)
    interface: list[InterfaceTable] = field(default_factory=list)
    damping: DampingTable = field(default_factory=DampingTable)
    solver: SolverTable = field(default_factory=SolverTable)
    reduce: Annotated[list[ReduceTable], length("at least one table [[reduce]]", 1, sys.maxsize)]
    output: OutputTable
    response: ResponseTable | None = None
    certify: CertifyTable | None = None
    state_space: StateSpaceTable | None = None
    frame: FrameTable = field(default_factory=FrameTable)
    envelope: EnvelopeTable | None = None
    stiffening: StiffeningTable | None = None
    preload: PreloadTable | None = None
    spin: SpinTable | None = None
    flow: list[FlowTable] = field(default_factory=list)
    modes: ModesTable = field(default_factory=ModesTable)
    stress: StressTable | None = None
    check: CheckTable = field(default_factory=CheckTable)

    def refuse_conflicts(self) -> None:
        for refuse in (self._one_source, self._parameters, self._flows, self._spins_once, self._materials):
            refuse()

    def _one_source(self) -> None:
        given = self.model.mesh or self.model.file
        if not given and not self.substructure:
            raise InputError(
                '[model]: mesh is missing; expected the path of a mesh file such as "conrod.msh" (or file = a model '
                "file, or tables [[substructure]])"
            )
        if given and (self.substructure or self.couple):
            raise InputError("[[substructure]] or [[couple]] was given beside a mesh or a model file; choose one")
        if self.substructure and self.preload is not None:
            raise InputError("[preload] was given for an assembly of bodies, which have no elements; leave it out")

    def _parameters(self) -> None:
        varied = any(table.method == "parametric" for table in self.reduce)
        if varied and not self.parameter:
            raise InputError('method = "parametric" needs parameters; add at least one table [[parameter]]')
        if not self.parameter:
            return
        if not varied:
            raise InputError('[[parameter]] was given; add a [[reduce]] with method = "parametric", or leave it out')
        if self.model.mesh is None:
            raise InputError("a model file brings its matrices; parameters need a mesh ([model] mesh)")
        loads = [table.name for table in self.parameter if table.property == "preload"]
        if len(loads) != (self.preload is not None):
            raise InputError(
                f"{len(loads)} parameters with property = 'preload' were given {'with' if self.preload else 'without'} "
                "a table [preload]; expected one of them for that table, whose loads it multiplies"
            )
        if self.spin is not None:
            raise InputError("[spin] was given beside [[parameter]], which change its stress; leave one of them out")

    def _flows(self) -> None:
        if self.flow and self.model.file is None:
            raise InputError("[[flow]] was given without a model file; a mesh of solids has no tubes of beam elements")

    def _spins_once(self) -> None:
        for key in ("frame", "envelope", "stiffening"):
            if self.spin is not None and key in self.given:
                raise InputError(
                    f"[{key}] was given beside [spin]: a floating frame that spins in a simulator would count the "
                    "gyroscopic terms twice; leave one of them out (for stress stiffness alone take [preload])"
                )
        if self.spin is not None and self.state_space is not None:
            raise InputError("[state_space] was given beside [spin], but would be of the body at rest; leave one out")
        if self.spin is not None and self.preload is not None:
            raise InputError("[preload] was given beside [spin], which has its own static stress; leave one out")

    def _materials(self) -> None:
        if self.model.mesh is not None and not self.material:
            raise InputError("material is missing; expected at least one table [[material]]")
        if self.model.mesh is None and self.model.engine is None and self.material:
            what = "a model file" if self.model.file is not None else "bodies"
            raise InputError(f"[[material]] was given for {what}, whose matrices are ready; leave it out")
