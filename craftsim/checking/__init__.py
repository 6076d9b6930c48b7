"""One action tried in physics: what it did, what it touched, and how it is judged."""
