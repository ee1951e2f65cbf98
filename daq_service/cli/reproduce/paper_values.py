"""Values printed in the paper, stored only here. Drawing code and causes read them here.

Source: the paper's text, captions and tables; its curves are not digitised. "About" and other words of
the paper are in `wording`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperValue:
    """One quantity of one figure or table.

    Attributes
    ----------
    item
        Name of the figure or table here.
    value
        As printed; None if the paper has only words.
    decimals
        Printed digits behind the point: ours is shown with one more.
    wording
        The paper's own qualification: "about", "+-", "no trend".
    where
        Section, figure, table or equation of the paper.
    """

    item: str
    quantity: str
    text: str
    value: float | None
    unit: str
    decimals: int
    where: str
    wording: str = ""


def _value(
    item: str, quantity: str, text: str, value: float | None, unit: str, where: str, wording: str = ""
) -> PaperValue:
    digits = "" if value is None else f"{value:.10g}".partition(".")[2]
    return PaperValue(
        item=item,
        quantity=quantity,
        text=text,
        value=value,
        unit=unit,
        decimals=len(digits),
        where=where,
        wording=wording,
    )


_TABLE_2_COLUMNS = (
    ("impact_speed", "striker's speed", "m/s"),
    ("particle_speed", "largest particle speed", "m/s"),
    ("isw_ratio", "ISW over that of case 3", "1"),
    ("inelasticity", "lambda, eq. 9", "1"),
    ("restitution", "e, eq. 10", "1"),
    ("amplitude_ratio", "AR, eq. 11", "1"),
    ("contact_time", "tau_c, eq. 12", "1"),
    ("tof", "ToF, eq. 13", "us"),
)
TABLE_2_PRINT = {
    1: ("2.0", "0.20", "0.14", "0.59", "0.237", "0.68", "0.624", "3.38", "430"),
    2: ("3.5", "0.26", "0.18", "0.81", "0.249", "0.66", "0.609", "3.39", "409"),
    3: ("5.0", "0.31", "0.21", "1.00", "0.258", "0.65", "0.598", "3.40", "395"),
    4: ("6.5", "0.36", "0.25", "1.20", "0.266", "0.64", "0.589", "3.40", "384"),
    5: ("8.0", "0.40", "0.27", "1.36", "0.273", "0.64", "0.585", "3.41", "377"),
}
"""Drop height in mm, then the columns above, digit for digit."""

TABLE_2 = tuple(
    PaperValue(
        item="table2",
        quantity=f"{name}_{case}",
        text=f"case {case} ({printed[0]} mm): {text}",
        value=float(cell),
        unit=unit,
        decimals=len(cell.partition(".")[2]),
        where="Table 2",
    )
    for case, printed in TABLE_2_PRINT.items()
    for (name, text, unit), cell in zip(_TABLE_2_COLUMNS, printed[1:], strict=True)
)

SENSORS = (("sphere", "sensor a sphere (eqs 1-2)"), ("disk", "sensor two disks (the rig)"))
_DEPTH_PRINT = (
    ("mindlin", "MATLAB (plate theory)", 319.0, 355.0, 0.84, 0.76),
    ("solid", "ABAQUS (solid)", 326.0, 379.0, 0.74, 0.57),
)
_LIMITS = (("B", 21.9, 19.7), ("C", 15.4, 17.1), ("D", 13.7, 14.4))
_Printed = tuple[str, str, float | None, str, str] | tuple[str, str, float | None, str, str, str]
_PRINTED: Mapping[str, Sequence[_Printed]] = {
    "table1": (
        ("patch_A", "corroded square at A", 25.4, "mm", "Table 1"),
        ("patch_B", "corroded square at B", 25.4, "mm", "Table 1"),
        ("patch_C", "corroded square at C", 50.8, "mm", "Table 1"),
        ("loss_D", "lost wall at D at the end", 0.0, "%", "Table 1", "pristine"),
        ("end", "end of the test", 350.0, "h", "section 2", "about"),
        ("sets", "sets of measurements", None, "1", "sections 2 and 4", "every 30 min, then hourly"),
    ),
    "fig5": (
        ("elements", "elements of the plate", 9216.0, "1", "section 3"),
        ("contact_element", "element at the contact", 0.1, "mm", "section 3"),
        ("spheres_below", "spheres between sensor and plate", 4.0, "1", "eq. 13"),
    ),
    "fig6": (
        ("contact_element", "element at the contact", 0.5, "mm", "section 3"),
        ("impact_speed", "striker's speed", 0.31, "m/s", "section 3"),
    ),
    "fig7": (
        ("isw_time", "ISW at", 150.0, "us", "section 4", "around"),
        ("change_hour_B", "change seen at B from", 75.0, "h", "section 4", "about; measurement 150"),
        ("change_hour_C", "change seen at C from", 75.0, "h", "section 4", "about; measurement 150"),
    ),
    "fig8": (
        ("tof_start_B", "B: ToF of the fit at hour 0", 325.0, "us", "section 4", "about"),
        ("tof_start_C", "C: ToF of the fit at hour 0", 325.0, "us", "section 4", "about"),
        ("tof_start_D", "D: ToF of the fit at hour 0", 325.0, "us", "section 4", "about"),
        ("tof_rise_B", "B: rise of ToF to the last set", 10.0, "%", "section 4", "about"),
        ("tof_rise_C", "C: rise of ToF to the last set", 10.0, "%", "section 4", "about"),
        ("tof_rise_D", "D: rise of ToF to the last set", 0.0, "%", "section 4", "relatively constant"),
    ),
    "fig9": (
        ("ar_start_B", "B: AR of the fit at hour 0", 0.49, "1", "section 4", "around; about half"),
        ("ar_start_C", "C: AR of the fit at hour 0", 0.49, "1", "section 4", "around; about half"),
        ("ar_start_D", "D: AR of the fit at hour 0", 0.5, "1", "section 4", "about half"),
        ("ar_end_B", "B: AR at the last set", 0.35, "1", "section 4", "around"),
        ("ar_end_C", "C: AR at the last set", 0.35, "1", "section 4", "around"),
        ("ar_fall_B", "B: change of AR to the last set", -30.0, "%", "section 4"),
        ("ar_fall_C", "C: change of AR to the last set", -30.0, "%", "section 4"),
        ("ar_fall_D", "D: change of AR to the last set", 0.0, "%", "section 4", "mostly constant"),
    ),
    "fig10": (
        ("e_case_3", "e at lambda = 0.258", 0.65, "1", "Table 2, case 3", "by eq. 10"),
        ("tau_c_case_3", "tau_c at lambda = 0.258", 3.40, "1", "Table 2, case 3", "by eq. 12"),
    ),
    "fig11": (
        ("isw_trend_B", "B: change of the ISW's fit over the test", 0.0, "%", "section 4", "no trend"),
        ("isw_trend_C", "C: change of the ISW's fit over the test", 0.0, "%", "section 4", "no trend"),
        ("isw_trend_D", "D: change of the ISW's fit over the test", 0.0, "%", "section 4", "no trend"),
    ),
    "fig12": (
        ("tof_plus", "coupled model: ToF for an ISW 20 % stronger", 2.5, "%", "section 4", "+-; size only"),
        ("tof_minus", "coupled model: ToF for an ISW 20 % weaker", 2.5, "%", "section 4", "+-; size only"),
        ("ar_plus", "coupled model: AR for an ISW 20 % stronger", 1.5, "%", "section 4", "+-; size only"),
        ("ar_minus", "coupled model: AR for an ISW 20 % weaker", 1.5, "%", "section 4", "+-; size only"),
        ("tof", "coupled model: ToF", 319.0, "us", "section 4"),
        ("ar", "coupled model: AR", 0.837, "1", "section 4"),
        ("tof_zener", "Zener's model: ToF", 395.0, "us", "Table 2, case 3"),
        ("ar_zener", "Zener's model: AR", 0.598, "1", "Table 2, case 3"),
        ("ar_measured", "measured on the pristine plate: AR", 0.5, "1", "section 4"),
        ("gamma_tof", "gamma 1,000 N s/m at the plate: shift of ToF", None, "us", "section 4", "minor"),
        ("gamma_ar", "gamma 1,000 N s/m at the plate: shift of AR", None, "1", "section 4", "significant"),
    ),
    "fig13": tuple(
        (f"{model}_{sensor}_{quantity}", f"{program}, {label}: {text}", value, unit, "section 4")
        for model, program, tof_0, tof_80, ar_0, ar_80 in _DEPTH_PRINT
        for sensor, label in SENSORS
        for quantity, text, value, unit in (
            ("tof_0", "ToF, pristine", tof_0, "us"),
            ("tof_80", "ToF at 80 % depth", tof_80, "us"),
            ("ar_0", "AR, pristine", ar_0, "1"),
            ("ar_80", "AR at 80 % depth", ar_80, "1"),
        )
    ),
    "fig14": (
        *(
            (
                f"limit_{source}_{p}",
                f"{p}: mean + 3 SD of the baseline's distances ({source})",
                value,
                "1",
                place,
            )
            for p, text, caption in _LIMITS
            for source, value, place in (
                ("text", text, "section 4, text"),
                ("caption", caption, "figure 14, caption"),
            )
        ),
        *(
            (f"outliers_{limit}_{p}", f"{p}: outliers after 100 h, {label}", value, "%", "section 4")
            for p, value in (("B", 80.0), ("C", 92.0), ("D", 8.0))
            for limit, label in (("paper", "mean + 3 SD"), ("f", "exact limit (F)"))
        ),
        ("outliers_late_C", "C: outliers after 230 h, mean + 3 SD", 100.0, "%", "section 4"),
        ("smallest_loss", "smallest corrosion detected", 0.75, "mm", "section 5", "as small as"),
    ),
    "fig15": (
        ("initial", "A: initial wall", 6.35, "mm", "section 2"),
        ("thickness_300", "A: wall read at 300 h", 4.2, "mm", "section 4", "about"),
        ("loss_300", "A: loss read at 300 h", 36.0, "%", "section 4", "about"),
        ("core", "A: wall at the end under the probe", 3.8, "mm", "section 4", "cored"),
        ("linearity", "A: R^2 of a line through the loss", None, "1", "section 4", "overall linear"),
    ),
}
"""By item: quantity, what it is, value, unit, place in the paper and, where it qualifies, its words."""
PAPER_VALUES = (
    *TABLE_2,
    *(_value(item, *printed) for item, rows in _PRINTED.items() for printed in rows),
)

_BY_NAME = {(value.item, value.quantity): value for value in PAPER_VALUES}


def of_paper(item: str, quantity: str) -> PaperValue:
    """Return a value of the paper; KeyError for an unknown name."""
    return _BY_NAME[item, quantity]


def printed(item: str, quantity: str) -> float:
    """Return a printed number; ValueError if the paper prints none."""
    value = _BY_NAME[item, quantity].value
    if value is None:
        raise ValueError(f"the paper prints no number for {quantity} of {item}")
    return value


def values_of(item: str) -> tuple[PaperValue, ...]:
    """Return all values of the paper for an item."""
    return tuple(value for value in PAPER_VALUES if value.item == item)
