"""Logs of the commands and measurements of robots: type, files and recording."""
