"""Creation of a report from a data folder; slow, so a service calls it in a separate process."""

from __future__ import annotations

from pathlib import Path

from daq_service.processes.installation import require_extras
from daq_service.web.report.contents import read_report_contents


def build_report_page(
    folder: Path, *, from_h: float | None = None, to_h: float | None = None, audited: bool = False
) -> bytes:
    """Build the HTML of a report in UTF-8 (`contents.read_report_contents`); takes seconds.

    Raises
    ------
    UsageError
        The range is empty, or has too many sets; MissingExtraError: without the extra ``report``.
    StorageError
        There is no test, or it cannot be read.
    ValidationError, OSError
        Stored configuration, or audit log: as `contents.read_report_contents`.
    """
    require_extras("report")
    # Imports matplotlib, which nothing else of the service needs.
    from daq_service.web.report.figures import draw_position_figure, draw_summary_figure
    from daq_service.web.report.page import render_report_page

    contents = read_report_contents(folder, from_h=from_h, to_h=to_h, audited=audited)
    return render_report_page(
        contents,
        {position.name: draw_position_figure(contents, position) for position in contents.positions},
        {position.name: draw_summary_figure(contents, position) for position in contents.positions},
    )
