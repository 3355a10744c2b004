"""The tables and keys of a job file, as pydantic models; docs and error messages come from the descriptions."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from morembs.base.errors import nearest
from morembs.body.floating.preload import Preload
from morembs.body.floating.spinning import Rotation
from morembs.fem.interface import COUPLINGS
from morembs.parametric.parameter import NAME as PARAMETER
from morembs.parametric.parameter import PROPERTIES
from morembs.problem.damping import Damping, modal_steps
from morembs.reducers import REDUCERS
from morembs.responses.band import checked_band

Three = Annotated[list[float], Field(min_length=3, max_length=3)]
Six = Annotated[list[float], Field(min_length=6, max_length=6)]
# Names become groups of the HDF5 file.
SAFE_NAME = r"^[A-Za-z0-9_][A-Za-z0-9_.+-]*$"


class Table(BaseModel):
    """A table of the job file. The description of a key is what its error message says was expected."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class UnitsTable(Table):
    """Units by name."""

    length: str = Field(description='a unit of length such as "mm"')
    mass: str = Field(description='a unit of mass such as "t"')
    time: str = Field(description='a unit of time such as "s"')


class ModelTable(Table):
    """``[model]``: a mesh file, or a model file; and the units of all numbers in the mesh and in the job.

    A job with tables ``[[substructure]]`` has neither; ``units`` are those of its places and springs.
    """

    mesh: str | None = Field(default=None, min_length=1, description='the path of a mesh file such as "conrod.msh"')
    file: str | None = Field(
        default=None, min_length=1, description='the path of a model file of morembs import such as "conrod.model.h5"'
    )
    units: str | UnitsTable = Field(
        default="m-kg-s", description='"length-mass-time" such as "mm-t-s", or a table with length, mass and time'
    )
    mass_integration: Literal["element", "exact", "reduced"] = Field(
        default="element", description='"element", "exact" or "reduced"'
    )
    dialect: Literal["auto", "abaqus", "calculix"] = Field(
        default="auto", description='"auto", "abaqus" or "calculix": the program that a deck .inp was written for'
    )
    allow_includes_outside: bool = Field(
        default=False, description="true or false: a deck may include files from beyond its folder"
    )
    unsymmetric: Literal["refuse", "split", "symmetrise"] = Field(
        default="refuse", description='"refuse", "split" or "symmetrise": what becomes of the skew parts of K and D'
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.mesh is not None and self.file is not None:
            raise ValueError("mesh and file were both given; choose one")
        if self.file is not None and "mass_integration" in self.model_fields_set:
            raise ValueError("mass_integration was given for a model file, whose matrices are ready; leave it out")
        if self.dialect != "auto" and not (self.mesh or "").lower().endswith(".inp"):
            raise ValueError(f'dialect = "{self.dialect}" was given without a deck .inp; leave it out')
        return self


class RotationTable(Table):
    """A turn about an axis."""

    axis: Three = Field(description="a direction [x, y, z]")
    degrees: float = Field(description="a number")


class SubstructureTable(Table):
    """``[[substructure]]``: a body that is a part of an assembly, and its place."""

    name: str = Field(
        max_length=100, pattern=r"^[^/:\s.\x00-\x1f][^/:\x00-\x1f]*$", description="a name without colons and slashes"
    )
    body: str = Field(min_length=1, description='the path of a body file such as "link.h5"')
    reduction: str | None = Field(default=None, description="the body of the file, where it has several")
    job: str | None = Field(
        default=None, min_length=1, description='the path of the job file that made the body such as "link.toml"'
    )
    at: dict[str, float] = Field(
        default_factory=dict, description="values of its parameters in SI units such as { E = 2.0e11 }"
    )
    position: Three = Field(default=[0.0, 0.0, 0.0], description="[x, y, z] of the origin of its model")
    rotation: RotationTable | None = Field(default=None, description="a table { axis = [x, y, z], degrees = ... }")

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.job is not None and self.at:
            raise ValueError("job was given beside at; a certificate against the unreduced part takes nominal values")
        return self


class CoupleTable(Table):
    """``[[couple]]``: interfaces of two substructures that move as one, or that springs connect."""

    between: Annotated[list[str], Field(min_length=2, max_length=2)] = Field(
        description='two interfaces such as ["upper:TIP", "lower:ROOT"]'
    )
    components: list[int] = Field(default=[0, 1, 2, 3, 4, 5], min_length=1, description="some of [0, 1, 2, 3, 4, 5]")
    stiffness: Six | None = Field(default=None, description="six numbers, zero or more: springs, instead of one motion")
    damping: Six | None = Field(default=None, description="six numbers, zero or more, beside stiffness")


class MaterialTable(Table):
    """``[[material]]``: elastic constants and density of an element set, isotropic or orthotropic."""

    set: str = Field(default="all", description='the name of an element set, or "all"')
    young: float | Three = Field(description="one number, or [E1, E2, E3] for an orthotropic material")
    poisson: float | Three = Field(description="one number, or [nu12, nu13, nu23] for an orthotropic material")
    density: float = Field(description="a number")
    shear: Three | None = Field(default=None, description="[G12, G13, G23]")
    axes: Annotated[list[Three], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description="three rows, the material directions 1, 2, 3 in the frame of the mesh"
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        lists = [isinstance(self.young, list), isinstance(self.poisson, list), self.shear is not None]
        if any(lists) and not all(lists):
            raise ValueError(
                "an orthotropic material needs young = [E1, E2, E3], poisson = [nu12, nu13, nu23] and "
                "shear = [G12, G13, G23]; an isotropic one needs one young, one poisson and no shear"
            )
        if self.axes is not None and not all(lists):
            raise ValueError("axes was given for an isotropic material; leave it out")
        return self


class ParameterTable(Table):
    """``[[parameter]]``: what of the model varies, and between which values."""

    name: str = Field(max_length=100, pattern=PARAMETER, description="a name of letters, digits and _")
    property: str = Field(description="one of " + ", ".join(repr(name) for name in PROPERTIES))
    set: str | list[str] = Field(
        default="all",
        description='an element set, a list of them, "all", or the elements in a region such as "box:0,0,0,1,1,1"',
    )
    range: Annotated[list[float], Field(min_length=2, max_length=2)] = Field(description="[LOW, HIGH]")
    nominal: float | None = Field(default=None, description="a number in the range")
    displacement: str | None = Field(
        default=None, min_length=1, description='the path of a table id,dx,dy,dz such as "longer.csv"'
    )
    mesh: str | None = Field(default=None, min_length=1, description="the path of the mesh at the value 1")
    interface: str | None = Field(default=None, description="the interface that a spring holds")
    to: str | None = Field(default=None, description="another interface that it holds to, in place of the ground")
    stiffness: Six | None = Field(default=None, description="six numbers, zero or more, of a spring at the value 1")

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.property not in PROPERTIES:
            if self.property == "speed":
                raise ValueError(
                    "property = 'speed' was given; a table [spin] gives one body for all speeds, with the Coriolis "
                    "matrix that no stiffness tells"
                )
            raise ValueError(f"property = {self.property!r} was given; {nearest(self.property, PROPERTIES)}")
        moves = [key for key in ("displacement", "mesh") if getattr(self, key) is not None]
        if self.property == "morph" and len(moves) != 1:
            raise ValueError(f"a morph needs displacement or mesh; {' and '.join(moves) or 'neither'} was given")
        if self.property != "morph" and moves:
            raise ValueError(f"{moves[0]} was given beside property = {self.property!r}; it belongs to a morph")
        springs = [key for key in ("interface", "stiffness") if getattr(self, key) is not None]
        if self.property == "spring" and (len(springs) != 2 or self.to == self.interface):
            raise ValueError("a spring needs interface and stiffness = [six numbers], and to, if it has one, another")
        if self.property != "spring" and (springs or self.to is not None):
            raise ValueError(
                f"{(springs or ['to'])[0]} was given beside property = {self.property!r}; it belongs to a spring"
            )
        if self.property not in ("young", "density") and "set" in self.model_fields_set:
            raise ValueError(f"set was given beside property = {self.property!r}; it belongs to young and density")
        return self


class InterfaceTable(Table):
    """``[[interface]]``: where other bodies touch the part."""

    name: str = Field(max_length=100, pattern=r"^[^/\s.\x00-\x1f][^/\x00-\x1f]*$", description="a name without slashes")
    nodes: str | None = Field(default=None, description='a selection of nodes such as "set:BIGEND"')
    matrix: str | None = Field(
        default=None, description='in place of nodes, columns of B or rows of C such as "B:drive", "C:tip,base" or "B"'
    )
    coupling: str = Field(
        default="rigid", description="one of " + ", ".join(repr(name) for name in COUPLINGS.own if name != "matrix")
    )
    point: Three | None = Field(default=None, description="the origin of the interface, [x, y, z]")
    components: list[int] | None = Field(default=None, description="some of [0, 1, 2, 3, 4, 5]")

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if self.nodes is None and self.matrix is None:
            raise ValueError('nodes is missing; expected a selection of nodes such as "set:BIGEND"')
        if self.matrix is not None:
            beside = {"nodes", "coupling", "point", "components"} & self.model_fields_set
            if beside:
                raise ValueError(f"matrix and {min(beside)} were both given; columns of a matrix say all, leave it out")
        return self


class RayleighTable(Table):
    """D = alpha M + beta K, in the declared unit of time."""

    alpha: float = Field(default=0.0, ge=0, description="a number, zero or more (1/time)")
    beta: float = Field(default=0.0, ge=0, description="a number, zero or more (time)")


class DampingTable(Table):
    """``[damping]``: Rayleigh or modal damping, structural damping with either."""

    rayleigh: RayleighTable | None = Field(default=None, description="a table { alpha = ..., beta = ... }")
    modal: float | str | list[list[float]] | None = Field(
        default=None,
        description="a part of critical damping from 0 to 1, or a table [[0, ratio], [frequency_hz, ratio], ...], or "
        'the name of one such as "adams"',
    )
    structural: float | None = Field(
        default=None, ge=0, description="a loss factor, zero or more, for the frequency domain only"
    )

    @field_validator("modal")
    @classmethod
    def _ratios(cls, given: float | str | list[list[float]] | None) -> float | str | list[list[float]] | None:
        if isinstance(given, str | list):
            modal_steps(given)
        elif given is not None:
            Damping(modal=given)
        return given

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.rayleigh is not None and self.modal is not None:
            raise ValueError("rayleigh and modal were both given; choose one")
        return self


class SolverTable(Table):
    """``[solver]``: which sparse solver, and what it may use."""

    name: str = Field(default="auto", description='"auto" or a name that "morembs solvers" lists')
    memory: str | None = Field(default=None, description='a text such as "4 GiB" or "500 MB"')
    threads: int | None = Field(default=None, ge=1, le=4096, description="a count of threads from 1 to 4096")
    scratch: str | None = Field(default=None, min_length=1, description="the path of a folder for temporary files")
    out_of_core: bool = Field(default=False, description="true to keep the factor and all arrays on disk, or false")
    ranks: int | None = Field(default=None, ge=1, le=65536, description="a count of MPI processes from 1 to 65536")
    workers: int = Field(default=1, ge=1, le=1024, description="a count of processes from 1 to 1024")

    @model_validator(mode="after")
    def _ranks(self) -> Self:
        if self.ranks is not None and self.name not in ("auto", "mumps-ranks"):
            raise ValueError(f'ranks was given beside name = "{self.name}"; only "mumps-ranks" takes ranks')
        if self.ranks is not None and self.workers > 1:
            raise ValueError("ranks and workers were both given; choose one")
        return self


class ReduceTable(Table):
    """``[[reduce]]``: one reduced body. Further keys are the options of its method."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, allow_inf_nan=False)
    method: str = Field(description="one of " + ", ".join(REDUCERS.own))
    name: str | None = Field(
        default=None, max_length=100, pattern=SAFE_NAME, description="a name of letters, digits, _, -, + and ."
    )

    def options(self) -> dict[str, object]:
        """Keys besides name and method."""
        return dict(self.model_extra or {})


class OutputTable(Table):
    """``[output]``: the body file, and a picture if one is wanted."""

    path: str = Field(min_length=1, description='the path of the body file such as "conrod.h5"')
    nodes: Literal["all", "skin", "interfaces"] = Field(default="all", description='"all", "skin" or "interfaces"')
    picture: str | None = Field(
        default=None, pattern=r"\.(png|pdf|svg)$", description="the path of a .png, .pdf or .svg file"
    )


class ResponseTable(Table):
    """``[response]``: frequency response of the full and the reduced model at logarithmic steps."""

    from_hz: float = Field(gt=1e-9, lt=1e12, description="a positive frequency in Hz")
    to_hz: float = Field(gt=1e-9, lt=1e12, description="a positive frequency in Hz")
    points: int = Field(default=200, ge=2, le=100_000, description="a count from 2 to 100000")

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        if self.to_hz <= self.from_hz:
            raise ValueError(f"from_hz = {self.from_hz:g} must lie below to_hz = {self.to_hz:g}")
        return self


class CertifyTable(Table):
    """``[certify]``: limits of the errors at every frequency of a band."""

    band_hz: Annotated[list[float], Field(min_length=2, max_length=2)] = Field(description="[LOW, HIGH] in Hz")
    points: int = Field(default=200, ge=2, le=100_000, description="a count from 2 to 100000")
    bound: bool = Field(default=True, description="true or false")
    measure: Literal["envelope", "peak", "pointwise"] = Field(
        default="envelope", description='"envelope", "peak" or "pointwise"'
    )
    damping_floor: float | None = Field(
        default=None, ge=0, lt=1, description="a part of critical damping from 0 to below 1, such as 0.01"
    )
    sharpness: float = Field(default=1.05, ge=1.01, le=2, description="a factor from 1.01 to 2")

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        checked_band(self.band_hz)
        return self


class StateSpaceTable(Table):
    """``[state_space]``: a file for control design of one body."""

    path: str = Field(pattern=r"\.(npz|mat)$", description="the path of a .npz or .mat file")
    inputs: list[str] = Field(min_length=1, description='inputs such as ["base:acceleration", "tip:force:z"]')
    outputs: list[str] = Field(min_length=1, description='outputs such as ["base:reaction", "tip:displacement"]')
    held: list[str] = Field(default_factory=list, description="names of the interfaces at rest")
    step: float | None = Field(default=None, gt=0, lt=1e12, description="a step in s for the zero-order hold")
    body: str | None = Field(default=None, description="the name of a reduction")


class FrameTable(Table):
    """``[frame]``: how the body frame follows the body."""

    kind: Literal["mean-axes", "center-of-mass", "tangent", "chord"] = Field(
        default="mean-axes", description='"mean-axes", "center-of-mass", "tangent" or "chord"'
    )
    interfaces: list[str] = Field(default_factory=list, description="names of the interfaces that the frame follows")
    origin: Three | Literal["center-of-mass"] | None = Field(
        default=None, description='the origin of the frame, [x, y, z] or "center-of-mass"'
    )


class EnvelopeTable(Table):
    """``[envelope]``: the largest loads in use, in the declared units (rad for angles)."""

    acceleration: float | None = Field(default=None, ge=0, description="a number, zero or more (length/time2)")
    angular_acceleration: float | None = Field(default=None, ge=0, description="a number, zero or more (rad/time2)")
    speed: float | None = Field(default=None, ge=0, description="a number, zero or more (rad/time)")
    force: float | None = Field(default=None, ge=0, description="a number, zero or more")
    moment: float | None = Field(default=None, ge=0, description="a number, zero or more")


class StiffeningTable(Table):
    """``[stiffening]``: geometric stiffening of every body."""

    share: float = Field(
        default=0.01, ge=0, lt=1, description="the part of the stiffness below which a term is left out, from 0 to 1"
    )


class PreloadTable(Table):
    """``[preload]``: loads in the declared units whose stress stiffens the body before it is reduced."""

    wrench: dict[str, Annotated[list[float], Field(min_length=6, max_length=6)]] = Field(
        default_factory=dict, description="a table { interface = [fx, fy, fz, mx, my, mz] }"
    )
    speed: float = Field(default=0.0, description="a number (rad/time)")
    axis: Three | None = Field(default=None, description="the direction of the axis of rotation, [x, y, z]")
    point: Three = Field(default_factory=lambda: [0.0, 0.0, 0.0], description="a point of the axis, [x, y, z]")
    acceleration: Three = Field(
        default_factory=lambda: [0.0, 0.0, 0.0], description="the acceleration of the body less gravity, [x, y, z]"
    )
    held: list[str] = Field(default_factory=list, description="names of the interfaces that carry the loads")
    follows: list[str] = Field(default_factory=list, description="names of the interfaces that the loads turn with")

    @model_validator(mode="after")
    def _loads(self) -> Self:
        Preload(**{**self.model_dump(), "held": tuple(self.held), "follows": tuple(self.follows)})
        return self


class SpinTable(Table):
    """``[spin]``: matrices of a frame that turns with the body, for all speeds."""

    speed: Annotated[list[float], Field(min_length=1)] = Field(description="speeds such as [0, 100, 400] (rad/time)")
    axis: Three = Field(description="the direction of the axis, [x, y, z]")
    point: Three = Field(default_factory=lambda: [0.0, 0.0, 0.0], description="a point of the axis, [x, y, z]")
    held: list[str] = Field(default_factory=list, description="names of the interfaces at rest in the frame that turns")
    stress: bool = Field(default=True, description="true or false: the centrifugal stress stiffens")
    modes: int = Field(default=12, ge=1, le=1000, description="a count of complex modes")

    @model_validator(mode="after")
    def _turns(self) -> Self:
        Rotation(axis=self.axis, point=self.point)
        return self


class FlowTable(Table):
    """``[[flow]]``: fluid that flows through a tube of beam elements, in the declared units."""

    path: str = Field(
        min_length=1, description='nodes in the order of the flow: "ids:4,7,2", "set:TUBE" or the path of a .csv'
    )
    mass_flow: float = Field(description="a number (mass/time)")
    density: float = Field(gt=0, description="a number above zero")
    area: float = Field(gt=0, description="the area of the bore")
    outlet: Literal["held", "free"] = Field(default="held", description='"held" or "free": the last node is a nozzle')


class ModesTable(Table):
    """``[modes]``: what ``morembs modes`` computes of the full model."""

    kind: Literal["real", "complex"] = Field(default="real", description='"real" or "complex"')
    count: int = Field(default=20, ge=1, le=1000, description="a count of modes")
    held: list[str] = Field(default_factory=list, description="names of the interfaces at rest, for complex modes")


class StressTable(Table):
    """``[stress]``: stress shapes of every body."""

    nodes: str = Field(default="skin", description='"skin", "all" or a selection such as "set:FILLET"')
    single: bool = Field(default=True, description="true or false")
    correction: bool = Field(default=True, description="true or false")
    jump: bool = Field(default=True, description="true or false")


class CheckTable(Table):
    """``[check]``: what the reduced bodies are compared with."""

    full_modes: int = Field(
        default=10, ge=0, description="a count of free-free frequencies of the full model, 0 for none"
    )


class JobTables(Table):
    """All tables of a job file."""

    model: ModelTable = Field(default_factory=ModelTable, description="a table [model]")
    substructure: list[SubstructureTable] = Field(default_factory=list, description="tables [[substructure]]")
    couple: list[CoupleTable] = Field(default_factory=list, description="tables [[couple]]")
    material: list[MaterialTable] = Field(default_factory=list, description="at least one table [[material]]")
    parameter: list[ParameterTable] = Field(default_factory=list, description="tables [[parameter]]")
    interface: list[InterfaceTable] = Field(default_factory=list, description="tables [[interface]]")
    damping: DampingTable = Field(default_factory=DampingTable, description="a table [damping]")
    solver: SolverTable = Field(default_factory=SolverTable, description="a table [solver]")
    reduce: list[ReduceTable] = Field(min_length=1, description="at least one table [[reduce]]")
    output: OutputTable = Field(description="a table [output]")
    response: ResponseTable | None = Field(default=None, description="a table [response]")
    certify: CertifyTable | None = Field(default=None, description="a table [certify]")
    state_space: StateSpaceTable | None = Field(default=None, description="a table [state_space]")
    frame: FrameTable = Field(default_factory=FrameTable, description="a table [frame]")
    envelope: EnvelopeTable | None = Field(default=None, description="a table [envelope]")
    stiffening: StiffeningTable | None = Field(default=None, description="a table [stiffening]")
    preload: PreloadTable | None = Field(default=None, description="a table [preload]")
    spin: SpinTable | None = Field(default=None, description="a table [spin]")
    flow: list[FlowTable] = Field(default_factory=list, description="tables [[flow]]")
    modes: ModesTable = Field(default_factory=ModesTable, description="a table [modes]")
    stress: StressTable | None = Field(default=None, description="a table [stress]")
    check: CheckTable = Field(default_factory=CheckTable, description="a table [check]")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        given = self.model.mesh or self.model.file
        if not given and not self.substructure:
            raise ValueError(
                '[model]: mesh is missing; expected the path of a mesh file such as "conrod.msh" (or file = a model '
                "file, or tables [[substructure]])"
            )
        if given and (self.substructure or self.couple):
            raise ValueError("[[substructure]] or [[couple]] was given beside a mesh or a model file; choose one")
        if self.substructure and self.preload is not None:
            raise ValueError("[preload] was given for an assembly of bodies, which have no elements; leave it out")
        return self

    @model_validator(mode="after")
    def _parameters(self) -> Self:
        varied = any(table.method == "parametric" for table in self.reduce)
        if varied and not self.parameter:
            raise ValueError('method = "parametric" needs parameters; add at least one table [[parameter]]')
        if not self.parameter:
            return self
        if not varied:
            raise ValueError('[[parameter]] was given; add a [[reduce]] with method = "parametric", or leave it out')
        if self.model.mesh is None:
            raise ValueError("a model file brings its matrices; parameters need a mesh ([model] mesh)")
        loads = [table.name for table in self.parameter if table.property == "preload"]
        if len(loads) != (self.preload is not None):
            raise ValueError(
                f"{len(loads)} parameters with property = 'preload' were given {'with' if self.preload else 'without'} "
                "a table [preload]; expected one of them for that table, whose loads it multiplies"
            )
        if self.spin is not None:
            raise ValueError("[spin] was given beside [[parameter]], which change its stress; leave one of them out")
        return self

    @model_validator(mode="after")
    def _flows(self) -> Self:
        if self.flow and self.model.file is None:
            raise ValueError("[[flow]] was given without a model file; a mesh of solids has no tubes of beam elements")
        return self

    @model_validator(mode="after")
    def _spins_once(self) -> Self:
        for key in ("frame", "envelope", "stiffening"):
            if self.spin is not None and key in self.model_fields_set:
                raise ValueError(
                    f"[{key}] was given beside [spin]: a floating frame that spins in a simulator would count the "
                    "gyroscopic terms twice; leave one of them out (for stress stiffness alone take [preload])"
                )
        if self.spin is not None and self.state_space is not None:
            raise ValueError("[state_space] was given beside [spin], but would be of the body at rest; leave one out")
        if self.spin is not None and self.preload is not None:
            raise ValueError("[preload] was given beside [spin], which has its own static stress; leave one out")
        return self

    @model_validator(mode="after")
    def _materials(self) -> Self:
        if self.model.mesh is not None and not self.material:
            raise ValueError("material is missing; expected at least one table [[material]]")
        if self.model.mesh is None and self.material:
            what = "a model file" if self.model.file is not None else "bodies"
            raise ValueError(f"[[material]] was given for {what}, whose matrices are ready; leave it out")
        return self
