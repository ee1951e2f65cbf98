"""Commands that assess files and stored tests."""

from __future__ import annotations

import click

from daq_service.cli.groups import options
from daq_service.cli.groups.options import argument, command, executor, option, repeated

assess = command(
    "assess",
    "offline.assess:run_assess",
    argument("tables", metavar="TABLE...", nargs=-1, required=True, type=options.FILE),
    option(
        "--baseline-rows", type=options.IntRange(min=1), help="Number of first rows that are the baseline."
    ),
    option("--baseline-where", metavar="COLUMN=VALUE", help="Instead: the rows whose column has this value."),
    option("--features", metavar="NAMES", help="These columns only, for example tof_pp_s; default: all."),
    option(
        "--budget",
        type=options.POSITIVE,
        default=0.2,
        show_default=True,
        help="Design false-alarm rate per transducer-year.",
    ),
    option("--sets-per-day", type=options.POSITIVE, default=24.0, show_default=True, help="Rows per day."),
    option("--no-rows", is_flag=True, help="With --json: leave out the line of each row."),
    option("--fleet", is_flag=True, help="Also assess all tables together: rows of the same times."),
    option(
        "--false-discovery-rate",
        type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True),
        default=0.1,
        show_default=True,
        help="Fraction of the transducers raised with --fleet that may be healthy.",
    ),
    options.JSON,
    details="Each table is one transducer, each row one set.",
)
features = command(
    "features",
    "offline.features:run_features",
    argument("files", metavar="FILE...", nargs=-1, required=True, type=options.FILE),
    option("--rate-hz", type=options.POSITIVE, help="Sample rate; default: 10 MHz."),
    option(
        "--pretrigger-s",
        type=options.POSITIVE,
        help="Time from start to trigger of a waveform; default: 100 us.",
    ),
    option(
        "--volts-per-count", type=options.POSITIVE, help="The values are counts of an ADC; default: volts."
    ),
    option("--rail-counts", metavar="LOW,HIGH", help="Counts at which the ADC clips."),
    option(
        "--isw-fwhm-s", type=options.POSITIVE, help="Usual width of the incident wave; default: as learnt."
    ),
    option("--isw-amplitude-v", type=options.POSITIVE, help="Usual amplitude of it; default: as learnt."),
    option("--psw-window-s", metavar="FROM,TO", help="Search window of the reflected wave, after the ISW."),
    options.JSON,
    details="FILE is .npy, .csv, .tdms or the .h5 file of a set.",
)
replay = command(
    "replay",
    "offline.evidence.replay:run_replay",
    argument("data_dir", type=options.FOLDER),
    repeated("--set", "given", "KEY=VALUE", "Assess with this setting, for example alarms.decides_by=chart."),
    option("--extract", is_flag=True, help="Extract the features from the waveforms again first."),
    executor("With --extract: where it runs; default: threads."),
    options.WORKERS,
    options.JSON,
)
