"""Runs that are kept by hand, for tests of what reads them."""

from guidefield.errors import Status
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN
from guidefield.messages.replies import ErrorReply, MotionReply
from guidefield.messages.requests import CertifyRequest, JointsGoal, MotionRequest, PlanRequest
from guidefield.stores.run_rows import NewRun
from guidefield.stores.runs import RunDatabase
from tests.replies import plan_reply

REQUEST = PlanRequest(robot="panda", scene="bookshelf", goal=JointsGoal({"a": 1.0}))


def new_run(
    run_id: str, request: MotionRequest = REQUEST, owner: str = PLAIN, encoding: Encoding = Encoding.JSON
) -> NewRun:
    """A run that could be kept."""
    kind = "certify" if isinstance(request, CertifyRequest) else "plan"
    return NewRun(owner, run_id, kind, codec.encode(request, encoding), encoding)


def begin(database: RunDatabase, run_id: str, request: MotionRequest = REQUEST, owner: str = PLAIN) -> NewRun:
    """Keep that a run begins."""
    run = new_run(run_id, request, owner)
    database.of(owner).begin(run)
    return run


def keep(
    database: RunDatabase,
    run_id: str,
    reply: MotionReply | Status = Status.SUCCESS,
    request: MotionRequest = REQUEST,
    owner: str = PLAIN,
) -> None:
    """Keep a run with its reply."""
    run = begin(database, run_id, request, owner)
    told = plan_reply(run_id, reply) if isinstance(reply, Status) else reply
    database.of(owner).finish(run, codec.encode(told)).result()


def fail(database: RunDatabase, run_id: str, error: ErrorReply) -> None:
    """Keep a run that an error ended."""
    database.of(PLAIN).fail(begin(database, run_id), error).result()
