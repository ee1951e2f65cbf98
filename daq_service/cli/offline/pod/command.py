"""Run `solimon pod`: tables of a50, a90 and a90/95 by rule, as text, JSON and figure."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from analysis.errors import AnalysisError
from analysis.statistics import detection_probability as pod
from analysis.wall.bank import ESTIMAND
from daq_service.cli.offline.csv_lines import finite_or_none
from daq_service.cli.offline.pod.runs import ONE_SET, SMALLEST_LOSS_M, Result, read_runs
from daq_service.errors import UsageError
from daq_service.processes.installation import require_extras


@dataclass(frozen=True, slots=True, kw_only=True)
class Pod:
    """Probability of detection of a rule; without a curve it is refused.

    Attributes
    ----------
    false_alarms, n_sound
        Sensors with a detection at a sound wall, of those that were observed there.
    """

    rule: str
    curve: pod.DetectionCurve | None
    refused: str | None
    false_alarms: int
    n_sound: int

    @property
    def rate_interval(self) -> tuple[float, float] | None:
        """Return the 95 % interval of the rate of false alarms; None if no sound wall was observed."""
        return pod.compute_rate_interval(self.false_alarms, self.n_sound) if self.n_sound else None


def run_pod(
    *,
    runs: tuple[Path, ...],
    position: str | None,
    threshold: float | None,
    figure: Path | None,
    as_json: bool,
) -> None:
    """Run `solimon pod`: print the probability of detection by rule.

    Parameters
    ----------
    position
        Only this position of data folders.
    threshold
        Smallest signal (a_hat) of tables that is a detection.
    figure
        New file, `.svg` or `.png`.

    Raises
    ------
    UsageError
        A run or option cannot be used, or no rule has enough sensors.
    """
    if figure is not None:
        require_extras("report")
        if figure.suffix.lower() not in (".svg", ".png"):
            raise UsageError(f"--figure {figure}: give a file that ends in .svg or .png")
    results = compute_pods(read_runs(runs, position, threshold))
    curves = {one.rule: one.curve for one in results if one.curve is not None}
    if not curves:
        reasons = "; ".join(dict.fromkeys(str(one.refused) for one in results))
        raise UsageError(reasons or "the runs hold no transducer with an assessed set")
    if figure is not None:
        from daq_service.cli.offline.pod.figure import draw_pods

        figure.write_bytes(draw_pods(curves, ESTIMAND, figure.suffix[1:].lower()))
    if as_json:
        answer = {"estimand": ESTIMAND, "confidence": pod.CONFIDENCE, "rules": list(map(_to_json, results))}
        click.echo(json.dumps(answer, allow_nan=False))
    else:
        click.echo("\n".join(_describe(results)))


def compute_pods(results: Sequence[Result]) -> list[Pod]:
    """Compute the POD of each rule, in the order of the results.

    Signals are fitted from the a50 of k of n sets on, since at smaller losses noise determines most of them;
    those of a table all.
    """
    pods: dict[str, Pod] = {}
    for rule in dict.fromkeys(one.rule for one in results):
        mine = [one for one in results if one.rule == rule]
        alarms: dict[str, bool] = {}
        for one in mine:
            if one.loss_m < SMALLEST_LOSS_M:
                alarms[one.sensor] = alarms.get(one.sensor, False) or one.signal >= 1.0
        a50_m = [one.curve.a50_m for name, one in pods.items() if name.endswith(" sets") and one.curve]
        least_m = max(a50_m, default=SMALLEST_LOSS_M) if rule == ONE_SET else SMALLEST_LOSS_M
        lost = [one for one in mine if one.loss_m >= least_m]
        sensors, loss_m = [one.sensor for one in lost], [one.loss_m for one in lost]
        curve: pod.DetectionCurve | None = None
        refused = None
        try:
            if rule == ONE_SET:
                curve = pod.fit_signal_response(sensors, loss_m, [one.signal for one in lost], 1.0)
            else:
                curve = pod.fit_detection_losses(sensors, loss_m, [one.signal >= 1.0 for one in lost])
        except AnalysisError as error:
            refused = str(error)
        n_false = sum(alarms.values())
        pods[rule] = Pod(rule=rule, curve=curve, refused=refused, false_alarms=n_false, n_sound=len(alarms))
    return list(pods.values())


def _to_json(one: Pod) -> dict[str, object]:
    """Return a result for JSON; null for a missing curve or an infinite bound."""
    names = ("rule", "refused", "false_alarms", "n_sound", "rate_interval")
    answer: dict[str, object] = {name: getattr(one, name) for name in names}
    if (curve := one.curve) is not None:
        values = ("n_sensors", "n_detected", "a50_m", "a90_m", "a90_95_m", *pod.SignalResponse.__slots__)
        answer |= {name: finite_or_none(getattr(curve, name)) for name in values if hasattr(curve, name)}
        answer["probabilities"], answer["loss_m"] = pod.PROBABILITIES.tolist(), curve.loss_m.tolist()
        answer["bound_m"] = list(map(finite_or_none, curve.bound_m.tolist()))
    return answer


def _describe(results: Sequence[Pod]) -> Iterator[str]:
    """Yield the lines of the table: a row per rule, then the reason of each refusal."""
    yield f"probability of detection (POD) of wall loss: {ESTIMAND}"
    heads = ("sensors", "detected", "a50", "a90", "a90/95")
    yield "rule".ljust(22) + "".join(map("{:>9}".format, heads)) + "  false alarms (95 % interval)"
    for one in results:
        cells, curve, rate = ["-"] * len(heads), one.curve, "no sound wall observed"
        if curve is not None:
            losses = (curve.a50_m, curve.a90_m, curve.a90_95_m)
            cells = [str(curve.n_sensors), str(curve.n_detected), *map(_format_mm, losses)]
        if one.rate_interval is not None:
            low, high = (f"{100.0 * rate:.1f}" for rate in one.rate_interval)
            rate = f"{one.false_alarms} of {one.n_sound} sensors ({low} to {high} %)"
        yield one.rule.ljust(22) + "".join(map("{:>9}".format, cells)) + f"  {rate}"
    yield from (f"{one.rule}: refused, {one.refused}" for one in results if one.refused)


def _format_mm(loss_m: float) -> str:
    """Format a length in mm with three significant digits; an infinite one as a dash."""
    return "-" if finite_or_none(loss_m) is None else f"{1e3 * loss_m:#.3g} mm"
