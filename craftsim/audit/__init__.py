"""The rules held against physics: the situations that are tried, and what is measured of them."""
