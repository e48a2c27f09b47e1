"""A service for all journeys, and those who ask it; a module that wants other options starts its own."""

from collections.abc import Iterator

import pytest

from guidefield import Client
from tests.journeys.service import CONNECTED_WITHIN, PlainClient, Service, plain_client, running_service


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    with running_service(tmp_path_factory.mktemp("data"), "--workers", "1") as service:
        yield service


@pytest.fixture(scope="module")
def wire(service: Service) -> Iterator[PlainClient]:
    with plain_client(service.endpoint) as client:
        yield client


@pytest.fixture(scope="module")
def client(service: Service) -> Iterator[Client]:
    with Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as client:
        yield client
