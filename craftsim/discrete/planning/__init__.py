"""The action helper: a search over moves and turns, and the queue that carries its plans out."""
