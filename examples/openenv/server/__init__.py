"""The server of the builders' protocol."""
