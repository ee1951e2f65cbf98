"""The line's analysis on files of other people: no test, no recorder, no data folder."""
