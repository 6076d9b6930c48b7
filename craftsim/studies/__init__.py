"""Studies: many training runs, what became of each, and the statistics of them all."""
