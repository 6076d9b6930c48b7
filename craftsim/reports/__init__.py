"""One report of a run, rendered as ``report.json``, on the terminal, and as an HTML page that needs no network."""
