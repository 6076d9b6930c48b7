"""What many trials say together: proportions, errors, durations, survival, comparisons and the rows of an audit."""
