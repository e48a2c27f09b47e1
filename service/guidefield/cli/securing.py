"""`guidefield secure`: the files of a service that a network can reach, and a file for each of its users."""

from __future__ import annotations

import base64
import json
import secrets
from pathlib import Path
from typing import TYPE_CHECKING, Any

from guidefield.cli.rights import Roles, access_control
from guidefield.errors import MalformedRequest
from guidefield.messages.identities import check_user

if TYPE_CHECKING:
    from guidefield.cli.certificates import Certificates

LOCAL_HOSTS = ("localhost", "127.0.0.1")
"""Names of a service on the client's own machine."""
SECRET_BYTES = 24
"""Random bytes of a password."""
READABLE, SECRET = 0o644, 0o600
"""Modes of files; those with a password or key are readable by their owner only."""


def secure(folder: Path, roles: Roles, hosts: tuple[str, ...], port: int) -> list[Path]:
    """Write certificates, passwords and Zenoh configurations into a folder, which is created.

    Args:
        folder: It must not hold any of these files.
        roles: Names by role.
        hosts: Names and addresses by which clients reach the service; each client's file has the first.
        port: Port of the service.

    Returns:
        The files: the service's configuration first, then those of the clients, then those that the service reads.

    Raises:
        MalformedRequest: if a name can't be a user's, or two have the same, or a file is there already.
        ImportError: if ``guidefield[secure]`` isn't installed.
    """
    from guidefield.cli.certificates import make_certificates

    names = roles.everybody()
    for name in names:
        check_user(name)
    if len(set(names)) < len(names):
        raise MalformedRequest(f"each name has one role, got {', '.join(names)}", names=list(names))
    made = make_certificates(hosts)
    passwords = {name: secrets.token_urlsafe(SECRET_BYTES) for name in names}
    where = folder.resolve()
    users = "".join(f"{name}:{password}\n" for name, password in passwords.items())
    clients = {
        name: _make_client_file(name, name in roles.operators, passwords[name], made, hosts[0], port) for name in names
    }
    files: dict[str, tuple[bytes, int]] = {
        "service.json5": (_add_comment(SERVICE, service_configuration(roles, where, port)), READABLE),
        **{f"{name}.json5": (content, SECRET) for name, content in clients.items()},
        "service.pem": (made.service, READABLE),
        "service.key": (made.key, SECRET),
        "users.txt": (users.encode(), SECRET),
    }
    return _write_files(where, files)


def service_configuration(roles: Roles, folder: Path, port: int) -> dict[str, Any]:
    """Make the Zenoh configuration of a service whose other files are in a folder."""
    tls = {"listen_certificate": str(folder / "service.pem"), "listen_private_key": str(folder / "service.key")}
    return {
        "mode": "peer",
        "listen": {"endpoints": [f"tls/0.0.0.0:{port}"]},
        "transport": {
            "link": {"tls": tls},
            "auth": {"usrpwd": {"dictionary_file": str(folder / "users.txt")}},
        },
        "access_control": access_control(roles),
    }


def client_configuration(
    name: str, operator: bool, password: str, authority: bytes, host: str, port: int
) -> dict[str, Any]:
    """Make the Zenoh configuration of a client, with the user whose keys the Python client uses."""
    configuration: dict[str, Any] = {
        "mode": "client",
        "connect": {"endpoints": [f"tls/{host}:{port}"]},
        "transport": {
            "link": {"tls": {"root_ca_certificate_base64": base64.b64encode(authority).decode()}},
            "auth": {"usrpwd": {"user": name, "password": password}},
        },
    }
    return configuration if operator else {**configuration, "metadata": {"guidefield": {"user": name}}}


SERVICE = """A service that whole networks can reach: encrypted, by user and password, each user on keys of its own.

    guidefield serve --config service.json5

The files that it names are the service's alone: service.key, and users.txt with a line name:password for each user."""
CLIENT = """All that {name} needs to use the service. It holds a password: give it to nobody else.

    guidefield query request.json --config {name}.json5
    Client.connect(config=Path("{name}.json5"))"""


def _make_client_file(name: str, operator: bool, password: str, made: Certificates, host: str, port: int) -> bytes:
    text = CLIENT.format(name=name)
    return _add_comment(text, client_configuration(name, operator, password, made.authority, host, port))


def _add_comment(text: str, configuration: dict[str, Any]) -> bytes:
    comment = "".join(f"// {line}".rstrip() + "\n" for line in text.splitlines())
    return f"{comment}{json.dumps(configuration, indent=2)}\n".encode()


def _write_files(folder: Path, files: dict[str, tuple[bytes, int]]) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    there = [name for name in files if (folder / name).exists()]
    if there:
        told = f"{folder} holds {', '.join(there)} already; name another folder, or delete what is to be made anew"
        raise MalformedRequest(told, path=str(folder))
    for name, (content, rights) in files.items():
        path = folder / name
        path.touch(mode=rights)
        path.write_bytes(content)
    return [folder / name for name in files]
