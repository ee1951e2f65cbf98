"""The line from strike to alarm: `recorder` is read first; `session` opens it, `assembly` makes its parts."""
