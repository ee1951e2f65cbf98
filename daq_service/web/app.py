"""The FastAPI application: shared parts, guards, problem details, one router a resource."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from fastapi import APIRouter, Depends, FastAPI
from starlette.middleware.gzip import GZipMiddleware

from daq_service.settings.tree import Settings
from daq_service.web import assets
from daq_service.web.answers import problem
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import problem_schemas, problems
from daq_service.web.answers.version import API_VERSION
from daq_service.web.auth.middleware import AuthenticationMiddleware
from daq_service.web.context import Context, context_of
from daq_service.web.guards import RequestGuard
from daq_service.web.request_times import AnswerTimes, RequestTimes
from daq_service.web.routes import (
    alarms,
    annotation,
    assessments,
    audit,
    commands,
    environment,
    features,
    files,
    fits,
    guidance,
    health,
    info,
    metrics,
    notifications,
    page,
    record_files,
    report,
    session,
    set_waveforms,
    sets,
    stream,
    tables,
    thickness,
    tokens,
    transducers,
    trends,
    waterfall,
    waveforms,
)
from daq_service.web.routes.admission import admit
from daq_service.web.routes.description import describe_roles, describe_words
from daq_service.web.routes.parameters import refuse_unknown_parameters

RESOURCES = (
    info,
    health,
    transducers,
    sets,
    set_waveforms,
    features,
    thickness,
    assessments,
    trends,
    fits,
    waterfall,
    waveforms,
    environment,
    alarms,
    annotation,
    guidance,
    commands,
    stream,
    session,
    tokens,
    audit,
    tables,
    record_files,
    files,
    notifications,
    report,
)
SMALL_BYTES = 2048
"""Two packets: less is sent as it is."""


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    async with context_of(app).followed():
        yield


class Service(FastAPI):
    """FastAPI whose errors are problem details, and whose description knows them."""

    def __init__(self, **options: Any) -> None:
        super().__init__(
            openapi_url="/api/v1/openapi.json",
            # Their pages load scripts from elsewhere; this service works offline.
            docs_url=None,
            redoc_url=None,
            default_response_class=JsonAnswer,
            **options,
        )
        problem.install(self)

    def openapi(self) -> dict[str, Any]:
        """Describe the interface (OpenAPI 3.1)."""
        if self.openapi_schema is None:
            document = super().openapi()
            document["components"]["schemas"].update(problem_schemas())
            describe_roles(document)
            describe_words(document)
        assert self.openapi_schema is not None
        return self.openapi_schema


def create_app(settings: Settings, data_folder: Path, *, no_person: bool = False) -> FastAPI:
    """Build the service of one data folder; it reads, and writes only operator commands.

    Parameters
    ----------
    data_folder
        May still be empty: answers are 503 "no data yet" until the recorder has stored something.
    no_person
        No token is asked for: never of an application that listens on a port.
    """
    app = application_of_test(lifespan=_lifespan)
    guard(app, Context(settings, data_folder, no_person=no_person))
    return app


def application_of_test(**options: Any) -> Service:
    """Build the routes of a test; which test a request is about, `context.context_at` says."""
    app = Service(
        title="solimon",
        version=API_VERSION,
        description=(
            "State, history and live stream of a test with highly nonlinear solitary waves. Values are "
            "SI with the unit in the name; `null` is not available; times are RFC 3339 UTC beside hours "
            "of the experiment; ranges are half-open; errors are problem details (RFC 9457)."
        ),
        **options,
    )
    app.include_router(health.probes)
    app.include_router(metrics.probes)
    app.include_router(versioned(RESOURCES))
    app.include_router(page.router)
    app.include_router(assets.router)
    return app


def versioned(resources: Iterable[ModuleType]) -> APIRouter:
    """Put resources below `/api/v1`: who asks is admitted, and no parameter is passed over."""
    api = APIRouter(
        prefix="/api/v1",
        dependencies=[Depends(admit), Depends(refuse_unknown_parameters)],
        responses=problems(422),
    )
    for resource in resources:
        api.include_router(resource.router)
    return api


def guard(app: FastAPI, context: Context, *, has_tests: bool = False) -> None:
    """Put before an application what is refused and looked at before any route.

    Parameters
    ----------
    context
        Of the service: its doors, and the names that it answers to.
    has_tests
        Paths may begin with a test's.
    """
    app.state.context = context
    app.state.answer_times = AnswerTimes()
    app.add_middleware(RequestTimes, times=app.state.answer_times)
    app.add_middleware(GZipMiddleware, minimum_size=SMALL_BYTES, compresslevel=1)
    app.add_middleware(AuthenticationMiddleware, doors=context.doors, has_tests=has_tests)
    app.add_middleware(assets.AssetsFirst)
    names = context.settings.web.names_elsewhere
    app.add_middleware(RequestGuard, audit_rejection=context.doors.audit_rejection, names_elsewhere=names)
