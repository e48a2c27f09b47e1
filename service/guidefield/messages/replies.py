"""All replies of the service, by the names under which everybody imports them, their union, and errors as they travel.

The files of replies say what may be changed in them; a new reply enters a union of its file. Errors travel as
`ErrorReply`; `make_error_reply` and `make_error` convert exceptions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from guidefield.errors import ERRORS, GuidefieldError, InternalFailure
from guidefield.messages.certify_reply import (
    Along as Along,
    CertifyReply as CertifyReply,
    LimitShares as LimitShares,
    LimitUse as LimitUse,
    MotionCertificate as MotionCertificate,
    MotionClearance as MotionClearance,
    Place as Place,
)
from guidefield.messages.conditions import PackedNumbers as PackedNumbers
from guidefield.messages.execution import ExecutionFigures as ExecutionFigures, MotionDeviation as MotionDeviation
from guidefield.messages.kinematics import (
    ClearanceReply as ClearanceReply,
    DynamicsReply as DynamicsReply,
    ForwardKinematicsReply as ForwardKinematicsReply,
    InverseKinematicsReply as InverseKinematicsReply,
    JacobianReply as JacobianReply,
    KinematicsReply,
    LinkWrench as LinkWrench,
    PointPotentialReply as PointPotentialReply,
    RobotPotentialReply as RobotPotentialReply,
)
from guidefield.messages.plan_reply import (
    CartesianUse as CartesianUse,
    CertificateFigures as CertificateFigures,
    ClearanceFigures as ClearanceFigures,
    Counters as Counters,
    EffortFigures as EffortFigures,
    EffortUse as EffortUse,
    Metrics as Metrics,
    Outcome as Outcome,
    Permission as Permission,
    PlanReply as PlanReply,
    Rows as Rows,
    SelfClearance as SelfClearance,
    Stage as Stage,
    StepFigures as StepFigures,
    Timing as Timing,
    Trajectory as Trajectory,
)
from guidefield.messages.service import (
    DeliveryRule as DeliveryRule,
    Disk as Disk,
    Health as Health,
    Histogram as Histogram,
    Identity as Identity,
    InfoReply as InfoReply,
    LimitInfo as LimitInfo,
    Progress as Progress,
    UserFigures as UserFigures,
)
from guidefield.messages.stored import (
    AnyRunReply as AnyRunReply,
    CertifyRunReply as CertifyRunReply,
    CoverInfo as CoverInfo,
    Done as Done,
    ErrorReply as ErrorReply,
    GeometryInfo as GeometryInfo,
    JointInfo as JointInfo,
    PairLeftOut as PairLeftOut,
    PartsInfo as PartsInfo,
    RobotReply as RobotReply,
    RobotsReply as RobotsReply,
    RobotSummary as RobotSummary,
    RunReply as RunReply,
    RunsReply as RunsReply,
    RunSummary as RunSummary,
    SceneReply as SceneReply,
    ScenesReply as ScenesReply,
    StoredReply,
)

MotionReply = PlanReply | CertifyReply
AnyReply = MotionReply | KinematicsReply | StoredReply | InfoReply | Progress

CERTIFY = "certify"
"""The tag of certify requests."""


class RequestTag(msgspec.Struct):
    """The tag of a request; empty in a plan request."""

    type: str = ""


class _Tagged(msgspec.Struct):
    request: RequestTag


def run_reply_kind(encoded: bytes, decode: Callable[..., Any]) -> type[AnyRunReply]:
    """Return the type of an encoded reply about a run, by its request; raises msgspec.DecodeError if it is none."""
    return CertifyRunReply if decode(encoded, type=_Tagged).request.type == CERTIFY else RunReply


def is_certify(request: bytes) -> bool:
    """Return whether JSON is a certify request; False if it can't be decoded."""
    try:
        return msgspec.json.decode(request, type=RequestTag).type == CERTIFY
    except (msgspec.DecodeError, UnicodeDecodeError):
        return False


def to_plain_data(message: msgspec.Struct) -> Any:
    """Convert a message to dicts, lists, strings and numbers."""
    return msgspec.to_builtins(message)


def make_error_reply(error: GuidefieldError) -> ErrorReply:
    """Make the message of an exception; details that aren't plain data become text."""
    details = msgspec.to_builtins(error.details, enc_hook=str)
    return ErrorReply(code=int(error.code), name=error.code.name, message=error.message, details=details)


def make_error(reply: ErrorReply) -> GuidefieldError:
    """Make the exception of an error message, as the inverse of `make_error_reply`; unknown codes are failures."""
    kind = _ERRORS.get(reply.code, InternalFailure)
    return kind(reply.message, **reply.details)


_ERRORS = {int(code): kind for code, kind in ERRORS.items()}
