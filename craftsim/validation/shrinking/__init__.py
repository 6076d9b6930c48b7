"""From a failure to the smallest world in which it still happens."""
