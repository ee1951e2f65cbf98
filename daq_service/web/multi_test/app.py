"""Application of several tests: their list, and the interface of each test below its name."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path

from fastapi import FastAPI
from starlette.types import Receive, Scope, Send

from daq_service.settings.tree import Settings
from daq_service.web.answers.problem import Problem, build_problem_response
from daq_service.web.app import Service, add_guard_middleware, build_versioned_router, create_app_of_test
from daq_service.web.auth.middleware import PAGE_FILES
from daq_service.web.context import Context
from daq_service.web.multi_test import routes
from daq_service.web.multi_test.listing import Listing
from daq_service.web.multi_test.open_tests import ServedTests
from daq_service.web.request_times import AnswerTimes
from daq_service.web.routes import audit, session, tokens

RESOURCES = (routes, session, tokens, audit)


@asynccontextmanager
async def _run_lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Open and close tests as needed while the application runs; then stop that and close all tests."""
    tests: ServedTests = app.state.tests
    maintenance = asyncio.create_task(tests.maintain_tests())
    try:
        yield
    finally:
        maintenance.cancel()
        with suppress(asyncio.CancelledError):
            await maintenance
        await tests.close()


class TestDispatcher:
    """Dispatches a request to the application of all tests, with the context of its test."""

    def __init__(self, tests: ServedTests, times: AnswerTimes) -> None:
        self._tests = tests
        self._application = create_app_of_test()
        self._application.state.answer_times = times

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Open the test of the path, keep it open during the response, and pass the request on.

        An unknown or unavailable test is answered with a problem; the page of an unavailable one is served.
        """
        async with AsyncExitStack() as stack:
            try:
                test = self._tests.find(scope["path_params"]["test"])
            except Problem as problem:
                await build_problem_response(scope, problem)(scope, receive, send)
                return
            path = scope["path"].removeprefix(f"/tests/{test.name}")
            try:
                if not path.startswith(PAGE_FILES) and (path != "/" or scope["state"]["person"]):
                    scope["state"]["test"] = await stack.enter_async_context(self._tests.use(test))
            except Problem as problem:
                if path != "/":
                    await build_problem_response(scope, problem)(scope, receive, send)
                    return
            await self._application(scope, receive, send)


def create_multi_test_app(paths: Sequence[Path], settings: Settings, folder: Path) -> FastAPI:
    """Create the application of several tests; no test is opened yet.

    Parameters
    ----------
    paths
        Configurations or data folders; those that cannot be shown are only listed.
    settings
        Settings of the service: its table ``web``.
    folder
        Folder of the service: tokens, audit of logins, log.

    Raises
    ------
    UsageError
        Two paths mean the same folder.
    """
    app = Service(
        "solimon, several tests",
        (
            "The list of the tests that this service has, and its doors: one login for all. Each test "
            "answers below `/tests/{test}` with an interface of its own, which "
            "`/tests/{test}/api/v1/openapi.json` describes."
        ),
        _run_lifespan,
    )
    context = Context(settings, folder)
    add_guard_middleware(app, context, has_tests=True)
    app.state.tests = ServedTests(paths, context.access_policy)
    app.state.listing = Listing(app.state.tests)
    app.include_router(routes.probes)
    app.include_router(build_versioned_router(RESOURCES))
    app.include_router(routes.pages)
    app.mount("/tests/{test}", TestDispatcher(app.state.tests, app.state.answer_times))
    return app
