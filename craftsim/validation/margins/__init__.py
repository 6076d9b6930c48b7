"""By how much each imperfection of the world may grow until an action fails."""
