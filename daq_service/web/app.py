"""FastAPI application: shared parts, guards, problem details, one router per resource."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType

from fastapi import APIRouter, Depends, FastAPI
from starlette.middleware.gzip import GZipMiddleware
from starlette.types import Lifespan

from daq_service.settings.tree import Settings
from daq_service.web import assets, routes
from daq_service.web.answers import problem
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import build_problem_schemas, describe_errors
from daq_service.web.answers.version import API_VERSION
from daq_service.web.auth.middleware import AuthenticationMiddleware
from daq_service.web.context import Context, find_app_context
from daq_service.web.documentation import Documentation
from daq_service.web.embedding import Embedding
from daq_service.web.guards import RequestGuard
from daq_service.web.request_times import AnswerTimes, RequestTimes
from daq_service.web.routes import health, metrics, page
from daq_service.web.routes.admission import require_role
from daq_service.web.routes.description import OpenApi, describe_names, describe_security
from daq_service.web.routes.parameters import refuse_unknown_parameters

_MODULES = (import_module(found.name) for found in iter_modules(routes.__path__, f"{routes.__name__}."))
RESOURCES = tuple(one for one in _MODULES if hasattr(one, "router") and one is not page)
"""Every module of `routes` that has a router."""
SMALL_BYTES = 2048
"""Two packets: smaller answers are not compressed."""


@asynccontextmanager
async def _run_lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Run the background tasks of the context while the application runs, and end them with it."""
    async with find_app_context(app).run_background_tasks():
        yield


class Service(FastAPI):
    """FastAPI whose errors are problem details, and whose description knows them."""

    def __init__(self, title: str, description: str, lifespan: Lifespan[FastAPI] | None = None) -> None:
        super().__init__(
            title=title,
            version=API_VERSION,
            description=description,
            lifespan=lifespan,
            openapi_url="/api/v1/openapi.json",
            # Their pages load scripts from elsewhere; this service works offline.
            docs_url=None,
            redoc_url=None,
            default_response_class=JsonAnswer,
            generate_unique_id_function=lambda route: route.name,  # the function, as in the table of roles
        )
        problem.install_error_handlers(self)
        self.mount("/docs", Documentation())

    def openapi(self) -> OpenApi:
        """Return the OpenAPI 3.1 description of the interface, with roles, units and examples.

        It is built at the first call.
        """
        if self.openapi_schema is None:
            document = super().openapi()
            document["components"]["schemas"].update(build_problem_schemas())
            describe_security(document)
            describe_names(document)
        assert self.openapi_schema is not None
        return self.openapi_schema


def create_app(settings: Settings, data_folder: Path, *, no_person: bool = False) -> FastAPI:
    """Create the application of one data folder, with routes, middleware and background tasks.

    Parameters
    ----------
    data_folder
        May still be empty: answers are 503 "no data yet" until the recorder has stored something.
    no_person
        No token is required: not allowed for an application that listens on a port.
    """
    app = create_app_of_test(lifespan=_run_lifespan)
    add_guard_middleware(app, Context(settings, data_folder, no_person=no_person))
    return app


def create_app_of_test(lifespan: Lifespan[FastAPI] | None = None) -> Service:
    """Create an application with the routes of a test but no middleware or context of its own.

    Each request finds its context with `find_request_context`.
    """
    app = Service(
        "solimon",
        (
            "State, history and live stream of a test with highly nonlinear solitary waves. Values are "
            "SI with the unit in the name; `null` is not available. Times are RFC 3339 UTC next to hours "
            "of the test; ranges are half-open. Errors are problem details (RFC 9457)."
        ),
        lifespan,
    )
    app.include_router(health.probes)
    app.include_router(metrics.probes)
    app.include_router(build_versioned_router(RESOURCES))
    app.include_router(page.router)
    app.include_router(assets.router)
    return app


def build_versioned_router(resources: Iterable[ModuleType]) -> APIRouter:
    """Build the router of `/api/v1` from the routers of modules.

    Each route checks the role and unknown parameters first.
    """
    api = APIRouter(
        prefix="/api/v1",
        dependencies=[Depends(require_role), Depends(refuse_unknown_parameters)],
        responses=describe_errors(422),
    )
    for resource in resources:
        api.include_router(resource.router)
    return api


def add_guard_middleware(app: FastAPI, context: Context, *, has_tests: bool = False) -> None:
    """Set the context and the response times of an application and add its middleware.

    From outside in: request checks, files of the page, authentication, compression, timing.

    Parameters
    ----------
    context
        Of the service: its access policy, and its host names.
    has_tests
        Paths may start with the prefix of a test.
    """
    app.state.context = context
    app.state.answer_times = AnswerTimes()
    app.add_middleware(RequestTimes, times=app.state.answer_times)
    app.add_middleware(GZipMiddleware, minimum_size=SMALL_BYTES, compresslevel=1)
    app.add_middleware(AuthenticationMiddleware, policy=context.access_policy, has_tests=has_tests)
    app.add_middleware(assets.AssetsFirst)
    web, policy = context.settings.web, context.access_policy
    app.add_middleware(
        RequestGuard,
        audit_rejection=policy.audit_rejection,
        names_elsewhere=web.names_elsewhere,
        embedding=Embedding(frozenset(web.embed_origins), lambda: policy.is_open),
    )
