"""The ROS node of the service: it answers each query exactly once, hears joint states and scenes, publishes topics.

Theory of operation. Zenoh's callbacks only sort. A thread of this node reads a query, translates it, waits for the
engine and answers; at most `MOST_UNDER_WAY` queries have one, and further ones are answered as busy. Threads of an
`Outbox` send answers. A payload that can't be read is answered by an error and logged, at most once in
`COMPLAINT_INTERVAL_S`. A node whose types are of another version doesn't reach this one: the log names it.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import zenoh
import zenoh.ext

from guidefield.endpoint.link import DEFAULT_SETTINGS, LATCHING, ROS_USER, RosSettings
from guidefield.endpoint.ros.refusals import Refused, moveit_code
from guidefield.endpoint.ros.rmw_zenoh import (
    GRAPH,
    LATCHED_QOS,
    Attachment,
    Entity,
    Kind,
    MismatchReport,
    Node,
    Types,
    Unreadable,
    types_of,
)
from guidefield.endpoint.ros.services import Ask, Service, ServiceAnswer, Services
from guidefield.endpoint.ros.snapshot import KnownRobot, KnownScene, Snapshot, apply_joint_state, apply_scene
from guidefield.errors import Status, convert_exception
from guidefield.messages.identities import Asker
from guidefield.pool.outbox import Outbox
from guidefield.robot.model.model import RobotModel
from guidefield.robot.urdf.xml import read_xml

_log = logging.getLogger(__name__)

NAME = "guidefield"  # of the node; other programs know it, and the names of topics (docs/ros.md)
# queries that may be under way; all nodes are one client of the queue, with half of `--queue`, 32 of the usual
MOST_UNDER_WAY = 64
MOST_UPDATES = 64  # number of published scenes that may wait
LAST_ANSWERS = 5.0  # longest time for the last answers to be read at the end [s]
COMPLAINT_INTERVAL_S = 1.0  # shortest time between two logged faults of messages [s]
PUBLISHED = {
    "display_planned_path": "moveit_msgs/msg/DisplayTrajectory",
    "guidefield/plans": "std_msgs/msg/String",
}
LATCHED = {"robot_description": "std_msgs/msg/String"}


class _Publisher:
    """Numbers what it publishes."""

    def __init__(self, type_name: str, publisher: Any) -> None:
        self.type_name = type_name
        self._publisher = publisher
        self._sender = os.urandom(16)
        self._numbers = itertools.count(1)

    def publish(self, payload: bytes) -> None:
        self._publisher.put(payload, attachment=Attachment(next(self._numbers), self._sender).write())


class RosNode:
    """A node that offers MoveIt's services."""

    def __init__(
        self,
        session: zenoh.Session,
        domain: int,
        types: Types,
        known: KnownScene,
        ask: Ask,
        description: str | None,
    ) -> None:
        self._session = session
        self._domain = domain
        self._types = types
        self._known = known
        self._services = Services(known, ask).all()
        self._description = description
        self._publishers: dict[str, _Publisher] = {}
        self._declared = contextlib.ExitStack()
        self._threads = ThreadPoolExecutor(MOST_UNDER_WAY, thread_name_prefix="guidefield-ros")
        self._updates = ThreadPoolExecutor(1, thread_name_prefix="guidefield-ros-scene")
        self._free, self._free_updates = threading.Semaphore(MOST_UNDER_WAY), threading.Semaphore(MOST_UPDATES)
        self._outbox = Outbox()
        self._complained = -COMPLAINT_INTERVAL_S

    def offer(self) -> None:
        """Declare the node, its services and its topics."""
        node = Node(self._domain, str(self._session.zid()), NAME)
        self._declare_token(node.token())
        entities = [*self._offer_services(), *self._offer_topics(), *self._listen()]
        for number, entity in enumerate(entities, 1):
            self._declare_token(node.token_of(number, entity))
        self._watch(MismatchReport(entities, _log.warning))
        if self._description is not None:
            self._publish("robot_description", {"data": self._description})

    def withdraw(self) -> None:
        """Undeclare the node, its services and topics; queries under way are still answered."""
        self._declared.close()

    def finish(self) -> None:
        """Wait for the last answers; the pool that makes them must have ended or be ending."""
        self._updates.shutdown(wait=True)
        self._threads.shutdown(wait=True)
        self._outbox.close(LAST_ANSWERS)

    def _watch(self, report: MismatchReport) -> None:
        def look(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                report.check(str(sample.key_expr))

        tokens = self._session.liveliness().declare_subscriber(f"{GRAPH}/{self._domain}/**", look, history=True)
        self._declared.callback(tokens.undeclare)

    def _declare_token(self, key: str) -> None:
        self._declared.callback(self._session.liveliness().declare_token(key).undeclare)

    def _entity(self, kind: Kind, name: str, type_name: str, **qos: str) -> Entity:
        return Entity(kind, name, type_name, self._types.type_hash(type_name), **qos)

    def _offer_services(self) -> Iterator[Entity]:
        for service in self._services:
            entity = self._entity(Kind.SERVICE, service.name, service.type_name)
            key = entity.key(self._domain)
            self._write(service.refuse(Status.FAILURE, ""), service)  # the first takes longer
            queryable = self._session.declare_queryable(key, partial(self._receive, service, key), complete=True)
            self._declared.callback(queryable.undeclare)
            yield entity

    def _offer_topics(self) -> Iterator[Entity]:
        for name, type_name in PUBLISHED.items():
            entity = self._entity(Kind.PUBLISHER, name, type_name)
            self._keep_publisher(name, type_name, self._session.declare_publisher(entity.key(self._domain)))
            yield entity
        for name, type_name in LATCHED.items():
            entity = self._entity(Kind.PUBLISHER, name, type_name, qos=LATCHED_QOS)
            cache = zenoh.ext.CacheConfig(max_samples=1)
            publisher = zenoh.ext.declare_advanced_publisher(
                self._session, entity.key(self._domain), cache=cache, publisher_detection=True
            )
            self._keep_publisher(name, type_name, publisher)
            yield entity

    def _listen(self) -> Iterator[Entity]:
        heard_of: dict[str, tuple[str, Callable[[zenoh.Sample], None]]] = {
            "joint_states": ("sensor_msgs/msg/JointState", self._hear_joints),
            "planning_scene": ("moveit_msgs/msg/PlanningScene", self._hear_scene),
        }
        for name, (type_name, hear) in heard_of.items():
            entity = self._entity(Kind.SUBSCRIPTION, name, type_name)
            self._declared.callback(self._session.declare_subscriber(entity.key(self._domain), hear).undeclare)
            yield entity

    def _keep_publisher(self, name: str, type_name: str, publisher: Any) -> None:
        self._publishers[name] = _Publisher(type_name, publisher)
        self._declared.callback(publisher.undeclare)

    def _publish(self, topic: str, message: dict[str, Any]) -> None:
        publisher = self._publishers[topic]
        try:
            publisher.publish(self._types.write(self._types.new(publisher.type_name, **message), publisher.type_name))
        except Exception:  # nobody hears it then; the response is on its way
            _log.exception("%s could not be published", topic)

    def _hear_joints(self, sample: zenoh.Sample) -> None:
        with self._complaining(str(sample.key_expr)):
            message = self._types.read(sample.payload.to_bytes(), "sensor_msgs/msg/JointState")
            self._known.update(lambda now: apply_joint_state(now, message))

    def _hear_scene(self, sample: zenoh.Sample) -> None:
        if not self._free_updates.acquire(blocking=False):
            self._complain(f"{sample.key_expr}: {MOST_UPDATES} scenes wait already; this one is left out")
            return
        self._updates.submit(self._read_scene, sample)

    def _read_scene(self, sample: zenoh.Sample) -> None:
        try:
            with self._complaining(str(sample.key_expr)):
                message = self._types.read(sample.payload.to_bytes(), "moveit_msgs/msg/PlanningScene")
                self._known.update(lambda now: apply_scene(now, message))
        finally:
            self._free_updates.release()

    @contextlib.contextmanager
    def _complaining(self, what: str) -> Iterator[None]:
        """Log the fault of a sample, which nobody answers."""
        try:
            yield
        except (Unreadable, Refused) as error:
            self._complain(f"{what}: {error}")
        except Exception:
            _log.exception("%s could not be used", what)

    def _complain(self, sentence: str) -> None:
        now = time.monotonic()
        if now - self._complained >= COMPLAINT_INTERVAL_S:
            self._complained = now
            _log.warning("%s", sentence)

    def _receive(self, service: Service, key: str, query: zenoh.Query) -> None:
        received = time.monotonic()
        if not self._free.acquire(blocking=False):
            message = f"SERVER_BUSY: {MOST_UNDER_WAY} requests are under way; ask again later"
            self._answer(service, key, query, service.refuse(Status.FAILURE, message))
            return
        self._threads.submit(self._serve, service, key, query, received)

    def _serve(self, service: Service, key: str, query: zenoh.Query, received: float) -> None:
        try:
            payload = b"" if query.payload is None else query.payload.to_bytes()
            message = self._types.read(payload, f"{service.type_name}_Request")
            answered = self._make_answer(service, message, received)
            self._answer(service, key, query, answered)
            for topic, published in answered.published.items():
                self._publish(topic, published)
        except Unreadable as error:
            self._complain(f"{key}: {error}")
            self._post(query, 0, partial(_send_error, query, str(error)))
        except Exception as error:
            _log.exception("%s failed by itself", service.name)
            self._post(query, 0, partial(_send_error, query, convert_exception(error).message))
        finally:
            self._free.release()

    def _make_answer(self, service: Service, message: Any, received: float) -> ServiceAnswer:
        try:
            return service.answer(message, received)
        except Refused as refused:
            code, sentence = refused.code, refused.message
        except Exception as error:
            known = convert_exception(error)
            if known is not error:
                _log.exception("%s failed by itself", service.name)
            code, sentence = moveit_code(known.code), f"{known.code.name}: {known.message}"
        if service.with_error is None:
            self._complain(f"{service.name}: {sentence}")
        return service.refuse(code, sentence)

    def _answer(self, service: Service, key: str, query: zenoh.Query, answered: ServiceAnswer) -> None:
        payload = self._write(answered, service)
        self._post(query, len(payload), partial(_send, query, key, payload))

    def _write(self, answered: ServiceAnswer, service: Service) -> bytes:
        name = f"{service.type_name}_Response"
        return self._types.write(self._types.new(name, **answered.response), name)

    def _post(self, query: zenoh.Query, size: int, send: Callable[[], None]) -> None:
        attachment = _read_attachment(query)
        asker = Asker(ROS_USER, "" if attachment is None else attachment.sender.hex())
        if not self._outbox.post(asker, size, send):
            self._complain(f"{query.key_expr}: too much waits to be read by this client already; an answer is dropped")
            query.drop()


def _read_attachment(query: zenoh.Query) -> Attachment | None:
    return None if query.attachment is None else Attachment.read(query.attachment.to_bytes())


def _send(query: zenoh.Query, key: str, payload: bytes) -> None:
    attachment = _read_attachment(query)
    with query:
        query.reply(key, payload, attachment=None if attachment is None else attachment.write())


def _send_error(query: zenoh.Query, sentence: str) -> None:
    with query:
        query.reply_err(sentence.encode())


def ros_node(settings: RosSettings, session: zenoh.Session, model: RobotModel, ask: Ask) -> RosNode:
    """Return a node on a session, not offered yet; raises RobotInvalid if the robot can't be offered over ROS."""
    robot = KnownRobot(settings.robot, model)
    known = KnownScene(Snapshot(robot))
    return RosNode(session, settings.domain, types_of(settings.distribution), known, ask, _description(model))


def client_config(endpoint: str) -> zenoh.Config:
    """Return the configuration of a session that is a client of a router, or of another node, at an endpoint."""
    config = zenoh.Config()
    for key, value in DEFAULT_SETTINGS.items():
        config.insert_json5(key, value)
    config.insert_json5(*LATCHING)
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    return config


@contextlib.contextmanager
def session_for(settings: RosSettings, own: zenoh.Session) -> Iterator[zenoh.Session]:
    """Lend the session in which nodes are reached: the service's own, or one that is a router's client.

    Raises zenoh.ZError if the router can't be reached.
    """
    if settings.connect is None:
        yield own
        return
    with zenoh.open(client_config(settings.connect)) as session:
        yield session


def _description(model: RobotModel) -> str | None:
    """Return the URDF as its file has it; None for a client's robot, whose text names files of this machine."""
    if model.source.urdf_path is None:
        _log.warning("robot %s was stored by a client: /robot_description isn't published", model.name)
        return None
    return read_xml(model.source.urdf_path)
