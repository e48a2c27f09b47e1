"""A light Python client, without numeric packages: typed requests in, typed replies out, over Zenoh."""

from guidefield.client.asynchronous import AsyncClient
from guidefield.client.client import Client

__all__ = ["AsyncClient", "Client"]
