"""File input within limits and atomic file output."""
