// Update the charts of the page: their features, positions and hours.

import { byId, el, setText } from "../dom.js";
import { fixed, scientific, setKey, significant } from "../format.js";
import { notesOn } from "../notes.js";
import { isFeature, featureLabel } from "./features.js";
import { baselineRanges, baselineAt } from "./baselines.js";
import { isOther, nameOf } from "./other-tests.js";
import { colorOf, fitLine, mergeHours, onAxis, relativeTo, scaleValues, shownUnit } from "./series.js";

/**
 * @typedef {import("./chart.js").SolimonChart} SolimonChart
 * @typedef {import("../view.js").View} View
 * @typedef {import("./series.js").Line} Line
 * @typedef {import("../format.js").SetKey} SetKey
 */

/** @param {any} fit @param {number} scale @param {string} unit */
function equation(fit, scale, unit) {
  if (!fit?.coefficients) return fit?.reason ?? "no fit yet";
  const [c0, c1, c2] = fit.coefficients.map((/** @type {number} */ c) => scale * c);
  const sign = (/** @type {number} */ value) => (value < 0 ? "− " : "+ ") + scientific(Math.abs(value));
  return (
    `${significant(c0)} ${sign(c1)} t ${sign(c2)} t²${unit ? ` ${unit}` : ""}, t in h · R² ` +
    `${fixed(fit.r_squared, 3)} · residual SD ` +
    `${significant(scale * fit.residual_sd)}${unit ? ` ${unit}` : ""}`
  );
}

/**
 * Return the hours of consecutive missed or disabled sets.
 *
 * @param {any[]} gaps
 * @returns {import("./marks.js").Range[]}
 */
export function gapRanges(gaps) {
  /** @type {any[]} */
  const ranges = [];
  for (const row of gaps) {
    const label = row.state === "disabled" ? "disabled" : /^(held|paused) by/.test(row.reason) ? "paused" : "missed";
    const last = ranges.at(-1);
    if (last && last.label === label && last.set_index + 1 === row.set_index)
      Object.assign(last, { to_h: row.due_h, set_index: row.set_index });
    else
      ranges.push({
        from_h: row.due_h,
        to_h: row.due_h,
        label,
        tone: label === "disabled" ? "alarm" : "warn",
        set_index: row.set_index,
      });
  }
  return ranges.map(({ from_h, to_h, label, tone }) => ({ from_h, to_h, label, tone }));
}

/**
 * Return unscheduled sets as lines.
 *
 * @param {any[]} confirmations
 * @returns {import("./marks.js").Range[]}
 */
export function confirmationRanges(confirmations) {
  const look = { label: "confirmation set", tone: "note", inLegend: true };
  return confirmations.map(({ due_h }) => ({ from_h: due_h, to_h: due_h, ...look }));
}

export class Board {
  /**
   * @param {import("../data-loader.js").DataLoader} loader
   * @param {import("./other-tests.js").OtherTests} others of other tests
   * @param {import("./chart.js").Host} host @param {(feature: string) => void} onFeature
   */
  constructor(loader, others, host, onFeature) {
    this.loader = loader;
    this.others = others;
    const chart = (/** @type {string} */ id) => /** @type {SolimonChart} */ (byId(id));
    this.charts = {
      distance: chart("distance"),
      chart: chart("chart"),
      tof: chart("tof"),
      amplitudeRatio: chart("amplitude-ratio"),
      thickness: chart("thickness"),
      feature: chart("feature"),
    };
    this.charts.distance.configure(
      { title: "Mahalanobis squared distance", log: true, empty: "No value yet: it needs the baseline" },
      host,
    );
    this.charts.chart.configure(
      { title: "Control chart (MEWMA)", log: true, empty: "No value yet: it needs the baseline" },
      host,
    );
    this.charts.tof.configure({ title: "Time of flight", empty: "No set yet" }, host);
    this.charts.amplitudeRatio.configure({ title: "Amplitude ratio", empty: "No set yet" }, host);
    this.charts.thickness.configure({ title: "Wall thickness", empty: "No thickness yet" }, host);
    this.charts.feature.configure({ title: "Any feature", empty: "No set yet" }, host);
    this.choice = /** @type {HTMLSelectElement} */ (
      el("select", { class: "field small", "aria-label": "Feature of this chart" })
    );
    this.choice.addEventListener("change", () => onFeature(this.choice.value));
    this.charts.feature.actions.prepend(this.choice);
    this.offered = "";
  }

  get all() {
    return Object.values(this.charts);
  }

  /** @param {string} position of this test or, as an entry of `compare`, of another */
  trend(position) {
    return isOther(position) ? this.others.trends.get(position) : this.loader.trend(position);
  }

  /** Baselines of a position. @param {string} position as of `trend` @returns {import("./baselines.js").Baseline[]} */
  baselines(position) {
    return (isOther(position) ? this.others.baselines.get(position) : this.loader.baselines.get(position)) ?? [];
  }

  redraw() {
    for (const chart of this.all) chart.draw();
  }

  /**
   * Positions of this test that are drawn.
   *
   * @param {View} view
   * @param {string} charted position of the solitary-wave charts
   */
  drawn(view, charted) {
    const probes = this.loader.info.positions
      .filter((/** @type {any} */ positionInfo) => positionInfo.method === "pulse_echo")
      .map((/** @type {any} */ positionInfo) => positionInfo.position);
    const probe = probes.includes(view.position) ? view.position : probes[0];
    const over = view.compare.filter(
      (position) => position !== charted && this.loader.positionInfo(position)?.method === "solitary_wave",
    );
    return { probe, over, all: [charted, ...over, ...(probe ? [probe] : [])] };
  }

  /** @param {View} view what is shown @param {string} charted position of the solitary-wave charts */
  update(view, charted) {
    if (!this.loader.info) return;
    this.offer(view.feature);
    const { probe, over } = this.drawn(view, charted);
    const others = (/** @type {string} */ method) =>
      view.compare.filter((entry) => isOther(entry) && this.trend(entry)?.method === method);
    const waves = [charted, ...over, ...others("solitary_wave")];
    const hasWall = (/** @type {string} */ position) =>
      !view.relative && this.trend(position)?.columns.thickness_m?.some(Number.isFinite); // no baseline has one
    const walls = waves.filter(hasWall);
    const measured = [...(probe ? [probe, ...others("pulse_echo")] : []), ...walls];
    this.charts.thickness.hidden = !measured.length;
    if (this.loader.trends.has(charted)) {
      this.distance(view, waves);
      this.controlChart(view, waves);
      this.draw(this.charts.tof, view, waves, "tof_pp_s", "tof_pp_us", "time of flight");
      this.draw(this.charts.amplitudeRatio, view, waves, "amplitude_ratio", "amplitude_ratio", "amplitude ratio");
    }
    if (measured.length && this.trend(measured[0]))
      this.draw(this.charts.thickness, view, measured, "thickness_m", "thickness_mm", "thickness");
    const ofProbe = probe && view.feature in (this.loader.baseline(probe)?.units ?? {});
    const shown = ofProbe ? [probe, ...others("pulse_echo")] : waves;
    if (this.trend(shown[0])?.columns[view.feature]) {
      this.charts.feature.setTitle(featureLabel(view.feature));
      this.draw(this.charts.feature, view, shown, view.feature, view.feature, featureLabel(view.feature));
    }
    for (const chart of this.all) chart.showTable(view.tables.includes(chart.id));
  }

  /** Offer all features of the API, by method. @param {string} feature */
  offer(feature) {
    const groups = new Map();
    for (const positionInfo of this.loader.info.positions) {
      const units = this.loader.baseline(positionInfo.position)?.units;
      if (units) groups.set(positionInfo.method, Object.keys(units).filter(isFeature));
    }
    const offered = JSON.stringify([...groups]);
    if (offered !== this.offered) {
      this.offered = offered;
      this.choice.replaceChildren(
        ...[...groups].map(([method, names]) =>
          el(
            "optgroup",
            { label: method.replace("_", " ") },
            ...names.map((/** @type {string} */ name) => el("option", { value: name, text: featureLabel(name) })),
          ),
        ),
      );
    }
    this.choice.value = feature;
  }

  /**
   * Return the lines of one feature for some positions, on one axis.
   *
   * @param {View} view @param {string[]} positions the first one is the chosen one
   * @param {string} field @param {string} key @param {string} short
   */
  lines(view, positions, field, key, short) {
    const shown = positions.filter((position) => this.trend(position)?.columns[field]);
    const trends = shown.map((position) => this.trend(position));
    const columns = trends.map((one) => one.columns);
    const { factor, unit, digits } = shownUnit(this.trend(positions[0]).units[field]);
    const { x, rows } = mergeHours(columns.map((one) => one.due_h));
    const relative = view.relative && !["distance_squared", "mewma_statistic"].includes(field);
    /** @type {Map<string, import("./series.js").Scale>} */
    const scales = new Map();
    const lines = shown.map((position, k) => {
      const scale = relative
        ? relativeTo(this.baselines(position), field)
        : (/** @type {number} */ value) => value * factor;
      scales.set(position, scale);
      const inUnit = (/** @type {(number | null)[]} */ values) =>
        onAxis(scaleValues(values, columns[k].due_h, scale), rows[k]);
      const of = positions.length > 1 ? ` ${nameOf(position)}` : "";
      const errors = columns[k][`standard_error_${field}`];
      const { interval_low_m: lower, interval_high_m: upper } = field === "thickness_m" ? columns[k] : {};
      const shifted = (/** @type {number} */ times) =>
        inUnit(
          columns[k][field].map((/** @type {number | null} */ value, /** @type {number} */ row) =>
            value === null || errors[row] === null ? null : value + times * errors[row],
          ),
        );
      return /** @type {Line} */ ({
        key: k ? `${key} ${position}` : key,
        label: `${short}${of}`,
        short: `${short}${of}`,
        color: colorOf(k),
        shape: k,
        ...(isOther(position) ? { dash: [5, 4] } : {}),
        points: true,
        y: inUnit(columns[k][field]),
        position,
        // A bin opens its outlier, if it has one.
        sets: onAxis(
          trends[k].bins
            ? columns[k].set_index.map(
                (/** @type {number} */ set, /** @type {number} */ row) =>
                  trends[k].bins.first_outlier_set_index[row] ?? set,
              )
            : columns[k].set_index,
          rows[k],
        ),
        firstSets: onAxis(columns[k].set_index, rows[k]),
        step: trends[k].bin_sets,
        ...(trends[k].bins?.minimum[field]
          ? { low: inUnit(trends[k].bins.minimum[field]), high: inUnit(trends[k].bins.maximum[field]) }
          : lower && upper
          ? { low: inUnit(lower), high: inUnit(upper) }
          : errors
            ? { low: shifted(-1), high: shifted(1) }
            : {}),
        quality: onAxis(columns[k].quality, rows[k]),
        ...(field === "thickness_m" && !isOther(position) ? { forecast: this.forecast(position, factor) } : {}),
      });
    });
    return { x, rows, lines, scales, relative, unit: relative ? "%" : unit, digits: relative ? 2 : digits, factor };
  }

  /** @param {string} position @param {number} factor @returns {import("./series.js").Forecast | undefined} */
  forecast(position, factor) {
    const row = this.loader.walls.get(position);
    if (!Number.isFinite(row?.forecast_h)) return undefined;
    return {
      hours: [row.due_h, row.forecast_h],
      low: [row.interval_low_m * factor, row.forecast_low_m * factor],
      median: [row.thickness_m * factor, row.forecast_m * factor],
      high: [row.interval_high_m * factor, row.forecast_high_m * factor],
      minimum: row.minimum_m === null ? null : row.minimum_m * factor,
    };
  }

  /** Describe the forecast of a line. @param {Line} line @param {string} unit */
  forecastText({ position, forecast }, unit) {
    if (!forecast) return "";
    const { hours, median, low, high } = forecast;
    const { quality } = this.loader.walls.get(/** @type {string} */ (position));
    return (
      `forecast of ${position} at hour ${fixed(hours[0], 1)} (${quality}) for hour ${fixed(hours[1], 1)}: ` +
      `${fixed(median[1], 2)} ${unit}, ${fixed(low[1], 2)} to ${fixed(high[1], 2)} ${unit} (90 %)`
    );
  }

  /** @param {View} view @param {string[]} positions */
  context(view, positions) {
    const [position] = positions;
    const alarms = this.loader.alarms
      .filter((alarm) => positions.includes(alarm.position))
      .map((alarm) => alarm.raised_h);
    const opened = view.set === null ? null : this.hourOf(view.position, view.set);
    const of = {
      method: this.loader.positionInfo(position).method,
      methods: Object.fromEntries(positions.map((one) => [one, this.loader.positionInfo(one)?.method])),
      positions: positions.filter((one) => !isOther(one)),
    };
    return {
      of,
      ranges: [
        ...baselineRanges(this.baselines(position)),
        ...notesOn(this.loader.notes, positions),
        ...positions.flatMap((one) => [
          ...gapRanges(this.loader.gaps.get(one) ?? []),
          ...confirmationRanges(this.loader.confirmations.get(one) ?? []),
        ]),
      ],
      alarms,
      opened,
      at:
        `Position ${position}` +
        (positions.length > 1 ? ` with ${positions.slice(1).map(nameOf).join(", ")}` : "") +
        (positions.some(isOther) ? ", each from its own hour 0" : ""),
    };
  }

  /** Return the hour of a set; null: it has not been read. @param {string} position @param {SetKey} key */
  hourOf(position, key) {
    const columns = this.trend(position)?.columns;
    const row = columns?.set_index.indexOf(key) ?? -1;
    const others = [...(this.loader.gaps.get(position) ?? []), ...(this.loader.confirmations.get(position) ?? [])];
    return row >= 0 ? columns.due_h[row] : (others.find((one) => setKey(one) === key)?.due_h ?? null);
  }

  /**
   * @param {SolimonChart} chart
   * @param {View} view
   * @param {string[]} positions
   * @param {string} field
   * @param {string} key
   * @param {string} short
   */
  draw(chart, view, positions, field, key, short) {
    const { lines, x, scales, relative, unit, digits, factor } = this.lines(view, positions, field, key, short);
    const { at, of, ...context } = this.context(view, positions);
    const fit = this.loader.fits.get(`${positions[0]} ${field}`);
    if (fit && (!relative || lines[0].y.some((value) => value !== null)))
      lines.push({
        key: "fit",
        label: positions.length > 1 ? `2nd-order fit ${positions[0]}` : "2nd-order fit",
        short: "fit",
        color: "--fit",
        points: false,
        dash: [7, 4],
        y: fitLine(fit, x, /** @type {any} */ (scales.get(positions[0]))),
      });
    const ahead = lines.map((line) => this.forecastText(line, unit)).filter(Boolean);
    const minimum = lines.find((line) => line.forecast)?.forecast?.minimum ?? null;
    if (minimum !== null)
      lines.push({
        key: "minimum",
        label: "minimum",
        short: "minimum",
        color: "--limit",
        points: false,
        y: x.map(() => minimum),
      });
    const [{ step }] = lines;
    const error = field === "thickness_m" ? "bars: interval, 95 % of a probe, 90 % of waves" : "bars: ± standard error";
    const bins = step && step > 1 ? `mean, min, max of ${step} sets each` : lines.some((line) => line.low) ? error : "";
    const remark = relative
      ? "relative to each position's own baseline" +
        (this.baselines(positions[0]).length > 1 ? ", from each one's first set on to that one" : "")
      : fit
        ? equation(fit, factor, unit)
        : "";
    chart.update({
      x,
      lines,
      // The title names the feature; a label keeps the areas of all charts the same.
      name: relative ? "Change (%)" : unit || " ",
      unit,
      digits,
      subtitle: [at, bins, remark, ...ahead].filter(Boolean).join(" · "),
      exported: { fields: [field], ...of },
      ...context,
    });
  }

  /** @param {View} view @param {string[]} positions */
  distance(view, positions) {
    const { lines, x, rows, unit } = this.lines(view, positions, "distance_squared", "distance_squared", "D²");
    lines.forEach(
      (line) =>
        (line.outlier = onAxis(
          this.trend(/** @type {string} */ (line.position)).columns.outlier,
          rows[lines.indexOf(line)],
        )),
    );
    const { at, of: source, ...context } = this.context(view, positions);
    const { columns } = this.trend(positions[0]);
    const { limits } = this.loader.info;
    const of = positions.length > 1 ? ` of ${positions[0]}` : "";
    lines.push(
      {
        key: "limit_f_predictive",
        label: `F limit${of}`,
        short: "F limit",
        color: "--limit",
        points: false,
        y: onAxis(columns.limit_f_predictive, rows[0]),
      },
      {
        key: "limit_mean_3sd",
        label: `mean + 3 SD${of}`,
        short: "mean + 3 SD",
        color: "--limit-other",
        points: false,
        dash: [2, 4],
        y: onAxis(columns.limit_mean_3sd, rows[0]),
      },
    );
    const rule = limits.decides_by === "k_of_n" ? `raises alarms: ${limits.k} of ${limits.n} sets` : "for information";
    const deciding =
      limits.deciding === "f_predictive"
        ? `outlier above the F limit (${significant(100 * limits.false_alarm_rate)} % false alarms)`
        : `outlier above ${limits.deciding}`;
    this.charts.distance.update({
      x,
      lines,
      name: "D²",
      unit,
      digits: 2,
      subtitle: `${at} · ${deciding} · ${rule}`,
      exported: { fields: ["distance_squared", "limit_f_predictive", "limit_mean_3sd", "outlier"], ...source },
      ...context,
    });
  }

  /** Draw the control chart, which averages over sets, and its limit. @param {View} view @param {string[]} positions */
  controlChart(view, positions) {
    const { lines, x, unit } = this.lines(view, positions, "mewma_statistic", "mewma_statistic", "MEWMA");
    const { at, of: source, ...context } = this.context(view, positions);
    const { limits } = this.loader.info;
    const limit = x.map((hour) => baselineAt(this.baselines(positions[0]), hour)?.row.limits?.mewma ?? null);
    const values = this.trend(positions[0]).columns.mewma_statistic ?? [];
    if (limit.some((value) => value !== null) && values.some((/** @type {number | null} */ value) => value !== null))
      lines.push({
        key: "mewma_limit",
        label: `limit${positions.length > 1 ? ` of ${positions[0]}` : ""}`,
        short: "limit",
        color: "--limit",
        points: false,
        y: limit,
      });
    const rule = limits.decides_by === "chart" ? "raises alarms" : "for information";
    const rate = `design rate ${significant(limits.false_alarms_per_sensor_year)} per transducer-year`;
    this.charts.chart.update({
      x,
      lines,
      name: "MEWMA",
      unit,
      digits: 2,
      subtitle: `${at} · ${rate} · ${rule}`,
      exported: { fields: ["mewma_statistic"], ...source },
      ...context,
    });
  }
}
