"""The commands, one module and one function each; registered in `craftsim.cli`."""
