"""Who may use which keys: Zenoh's access control for operators, users and onlookers.

Zenoh looks at each message of each link. What comes from a client may be a question, or that it wants to hear of
something; what goes to it may be an answer, or what is published. So nobody but the service answers, publishes or says
that it lives: a client is sent no question of another one, and what it publishes reaches nobody.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from guidefield.messages.identities import base_key, shared_key

ASK_MESSAGES = ["query", "declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]
"""What a client sends that asks and listens."""
ANSWER_MESSAGES = ["reply", "put", "declare_queryable", "liveliness_token"]
"""What it is sent."""
PRESENCE_MESSAGES = ["liveliness_token"]
"""What a client sends to say that it is there."""
PUT_MESSAGES, PUT_DECLARATIONS = ["put"], ["declare_subscriber"]
"""What a client sends for a stream of its own, and what the service says so that it is sent."""
UPDATE_KEY = "streams/*/update"
SUBSCRIBE_MESSAGES, PUBLISHED_MESSAGES = ["declare_subscriber"], ["put"]
"""What a client sends that listens, and what it is sent."""
PUBLIC_KEYS = ("guidefield/*/alive", "guidefield/*/starting")
"""What everybody may look at: which services there are."""
LIST_KEYS = ("info", "robots", "scenes", "runs")
SHARED_KEYS = ("robots/$*:$*", "scenes/$*:$*", "runs/$*:$*", "runs/$*:$*/recording", "runs/$*:$*/proof")
"""What others share: with an owner before the name a key is for reading alone, unless an operator asks."""


@dataclass(frozen=True)
class Roles:
    """Who may do what.

    Attributes:
        operators: They may do everything, on the keys without a user.
        users: Each has keys of its own.
        onlookers: They see lists, figures, and what is shared.
    """

    operators: tuple[str, ...] = ("operator",)
    users: tuple[str, ...] = ("user",)
    onlookers: tuple[str, ...] = ("onlooker",)

    def everybody(self) -> tuple[str, ...]:
        """All names."""
        return (*self.operators, *self.users, *self.onlookers)


def access_control(roles: Roles) -> dict[str, Any]:
    """The section ``access_control`` of the service's Zenoh configuration: what isn't allowed is denied."""
    published = [f"{shared_key('*')}/**"]
    rules: list[dict[str, Any]] = [
        *_make_rules("everybody", PUBLIC_KEYS),
        _make_rule("everybody listens", SUBSCRIBE_MESSAGES, "ingress", published),
        _make_rule("everybody hears", PUBLISHED_MESSAGES, "egress", published),
    ]
    policies: list[dict[str, Any]] = [{"rules": _ids(rules), "subjects": list(roles.everybody())}]
    of_roles = [
        *((name, ["guidefield/**"], base_key("*", "plain")) for name in roles.operators),
        *((name, [f"{base_key('*', name)}/**"], base_key("*", name)) for name in roles.users),
        *(
            (name, [f"{base_key('*', name)}/{key}" for key in (*LIST_KEYS, *SHARED_KEYS)], None)
            for name in roles.onlookers
        ),
    ]
    for name, keys, present in of_roles:
        own = _make_rules(f"user {name}", keys, None if present is None else f"{present}/clients/*")
        if present is not None:
            updates = [f"{present}/{UPDATE_KEY}"]
            own.append(_make_rule(f"user {name} sends updates", PUT_MESSAGES, "ingress", updates))
            own.append(_make_rule(f"user {name} may send updates", PUT_DECLARATIONS, "egress", updates))
        rules += own
        policies.append({"rules": _ids(own), "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "usernames": [name]} for name in roles.everybody()],
        "policies": policies,
    }


def _make_rules(who: str, keys: Sequence[str], present: str | None = None) -> list[dict[str, Any]]:
    """Rules that let somebody ask and be answered on some keys, and say on one that it is there."""
    found = [
        _make_rule(f"{who} asks", ASK_MESSAGES, "ingress", keys),
        _make_rule(f"{who} is answered", ANSWER_MESSAGES, "egress", keys),
    ]
    return (
        found if present is None else [*found, _make_rule(f"{who} is there", PRESENCE_MESSAGES, "ingress", [present])]
    )


def _make_rule(name: str, messages: Sequence[str], flow: str, keys: Iterable[str]) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "messages": list(messages),
        "flows": [flow],
        "key_exprs": list(keys),
    }


def _ids(rules: Iterable[dict[str, Any]]) -> list[str]:
    return [rule["id"] for rule in rules]
