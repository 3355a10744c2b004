"""The stages of a job, one file each: a new one is one line here, where the document of a result shall tell of it."""

from __future__ import annotations

from morembs.app.jobs.stages.body import Deliver
from morembs.app.jobs.stages.certificate import Certify
from morembs.app.jobs.stages.couple import Couple
from morembs.app.jobs.stages.effective_mass import EffectiveMass
from morembs.app.jobs.stages.factor import FactorCost
from morembs.app.jobs.stages.full_modes import FullModes
from morembs.app.jobs.stages.member import ReduceMember
from morembs.app.jobs.stages.model import Assemble, ReadMesh, ReadModel
from morembs.app.jobs.stages.parameters import Parameters, ParameterSteps
from morembs.app.jobs.stages.parts import Parts
from morembs.app.jobs.stages.picture import DrawnShapes, Picture
from morembs.app.jobs.stages.preload import PreloadStress
from morembs.app.jobs.stages.reduction import Reduction
from morembs.app.jobs.stages.response import Response
from morembs.app.jobs.stages.spin import SpinMatrices, SpinModes
from morembs.app.jobs.stages.stage import STAGES
from morembs.app.jobs.stages.state_space import StateSpace
from morembs.app.jobs.stages.unreduced import UnreducedParts
from morembs.app.jobs.stages.witness import Witness
from morembs.app.jobs.stages.write import WriteBody

STAGES |= {
    "shapes": DrawnShapes(),
    "body file": WriteBody(),
    "factor": FactorCost(),
    "members": ReduceMember(),
    "bodies": Parts(),
    "mesh": ReadMesh(),
    "model file": ReadModel(),
    "assembly": Assemble(),
    "parameters": Parameters(),
    "interfaces": Couple(),
    "preload": PreloadStress(),
    "unreduced parts": UnreducedParts(),
    "spin": SpinMatrices(),
    "reductions": Reduction(),
    "body": Deliver(),
    "certificates": Certify(),
    "response": Response(),
    "spin modes": SpinModes(),
    "full modes": FullModes(),
    "picture": Picture(),
    "state space": StateSpace(),
    "witness": Witness(),
    "effective masses": EffectiveMass(),
    "steps": ParameterSteps(),
}
