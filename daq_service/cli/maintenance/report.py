"""Run ``report``."""

from __future__ import annotations

from pathlib import Path

from daq_service.cli.maintenance.export import refuse_unsafe_target
from daq_service.processes.data_folder import choose_folder
from daq_service.processes.printing import print_result
from daq_service.settings.file import load_settings
from daq_service.shared_file import write_output
from daq_service.web.report.contents import read_report_contents
from daq_service.web.report.make import build_report_page
from daq_service.web.report.page import render_methods
from daq_service.web.report.pdf import print_page


def write_report(
    *,
    where: Path,
    from_h: float | None,
    to_h: float | None,
    out: Path | None,
    pdf: bool,
    methods: bool,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Run `solimon report`: write the report of a data folder, or of the folder of a configuration.

    Hours limit the range; None: open. The default file is ``report_FOLDER.html``, or ``.pdf``, in the working
    directory. ``methods`` prints a paragraph for a paper instead, and writes no file.

    Raises
    ------
    UsageError
        There is no test, the range is empty or too long, the file exists, or no browser prints the PDF.
    StorageError
        The catalogue cannot be read, or the file cannot be written.
    """
    folder = where if where.is_dir() else choose_folder(load_settings(where).storage, where, None)
    if methods:
        text = render_methods(read_report_contents(folder, from_h=from_h, to_h=to_h))
        print_result({"ok": True, "methods": text}, [text], as_json=as_json)
        return
    target = out or Path(f"report_{folder.name}.{'pdf' if pdf else 'html'}")
    refuse_unsafe_target(folder, target, overwrite=overwrite)
    content = build_report_page(folder, from_h=from_h, to_h=to_h, audited=True)
    if pdf:
        content = print_page(content, target)
    write_output(target, content)
    result = {"ok": True, "file": str(target), "n_bytes": len(content)}
    line = f"{target} ({len(content) / 1e6:.1f} MB)"
    print_result(result, [line], as_json=as_json)
