"""Export of tables as files: tables, rows in pages, and formats, for routes and command line."""
