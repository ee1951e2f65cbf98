"""Routes of a service of several tests: list, health checks, metrics of all tests."""

from __future__ import annotations

from collections.abc import Iterator

from fastapi import APIRouter, Request
from prometheus_client.metrics_core import GaugeMetricFamily, Metric
from starlette.responses import Response

from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import describe_errors
from daq_service.web.answers.problem import Problem, not_found
from daq_service.web.assets import build_asset_response, get_asset
from daq_service.web.context import Context
from daq_service.web.multi_test.answers import ListedTests, ServiceLiveness
from daq_service.web.multi_test.listing import Listing
from daq_service.web.multi_test.location import AbsentError, locate_test
from daq_service.web.multi_test.open_tests import ServedTests
from daq_service.web.routes.metrics import (
    OPENMETRICS,
    collect_clients,
    collect_service,
    collect_test,
    render_metrics,
)

router = APIRouter(tags=["tests"])
probes = APIRouter(tags=["health"])
pages = APIRouter(include_in_schema=False)
pages.add_api_route("/static/{name:path}", get_asset)


def _find_listing(request: Request) -> Listing:
    """Return the listing of tests that was set for the application."""
    listing = request.app.state.listing
    assert isinstance(listing, Listing)
    return listing


@router.get("/tests", response_model=ListedTests)
def list_tests(request: Request) -> JsonAnswer:
    """List the tests of this service with their states, and the remedy for those that cannot be shown.

    In the order of the command line. An entry is at most 2 s old, or 60 s without a running recorder.
    """
    return JsonAnswer({"items": _find_listing(request).read_entries()})


@probes.get("/healthz", response_model=ServiceLiveness)
async def get_liveness(request: Request) -> JsonAnswer:
    """Return that the process of the service responds, with the numbers of tests at their last read."""
    return JsonAnswer(_build_health_body(request))


@probes.get("/readyz", response_model=ServiceLiveness, responses=describe_errors(503))
def get_readiness(request: Request) -> JsonAnswer:
    """Return the numbers of all tests and of those that can be shown; 503 if none can."""
    entries = _find_listing(request).read_entries()
    if not any(entry["state"] == "shown" for entry in entries):
        raise Problem(
            "no-data-yet",
            f"None of {len(entries)} tests can be shown.",
            "/api/v1/tests has the reason and remedy of each.",
        )
    return JsonAnswer(_build_health_body(request))


def _build_health_body(request: Request) -> dict[str, object]:
    """Build the body of the liveness and readiness answers, with the numbers of all and of shown tests.

    ``status`` is ``ok``, and ``data`` is whether any test is shown. The shown tests are those of the last
    read of the list: 0 before the first.
    """
    shown = _find_listing(request).shown()
    return {"status": "ok", "data": shown > 0, "tests": len(request.app.state.tests.all), "shown": shown}


@probes.get("/metrics", response_class=Response, responses=OPENMETRICS)
def get_metrics(request: Request) -> Response:
    """Return the metrics of every test with a label `test`, and which tests can be shown.

    A test that cannot be shown has no other metrics.
    """
    tests: ServedTests = request.app.state.tests
    merged = {metric.name: metric for metric in collect_service()}
    shown = GaugeMetricFamily("solimon_test_shown", "1: the test can be shown", labels=["test"])
    for name, test in list(tests.all.items()):
        metrics = list(_collect_test_metrics(tests, name))
        shown.add_metric([name], float(bool(metrics)))
        if test.context is not None:
            metrics += collect_clients(test.context)
        for metric in metrics:
            family = merged.setdefault(metric.name, Metric(metric.name, metric.documentation, metric.type))
            family.samples += [
                sample._replace(labels={"test": name, **sample.labels}) for sample in metric.samples
            ]
    return render_metrics([*merged.values(), shown], request)


def _collect_test_metrics(tests: ServedTests, name: str) -> Iterator[Metric]:
    """Yield the metrics of a test without opening it, so that scraping does not keep every test open.

    Yields none if the test cannot be shown. Raises the errors of `collect_test`.
    """
    try:
        settings, folder = locate_test(tests.all[name].path, tests.access_policy)
    except AbsentError:
        return
    context = Context(settings, folder, access_policy=tests.access_policy)
    try:
        yield from collect_test(context)
    finally:
        context.catalogue_access.close()


@pages.get("/")
async def get_list_page(request: Request) -> Response:
    """Serve the HTML page with the list of tests, or 304 if the browser has it."""
    return build_asset_response("tests.html", request)


@pages.get("/api/v1/{rest:path}")
async def raise_unknown_resource(rest: str) -> Response:
    """Raise 404 with a reference to the list, for clients that expect the service of a single test."""
    raise not_found(
        f"There is no /api/v1/{rest[:80]} of all tests together.",
        "This service has several tests: /api/v1/tests lists them, each answers below /tests/NAME/api/v1.",
    )
