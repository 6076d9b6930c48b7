"""The grid world's compiled core: state, rules, search and batches."""
