"""From a car's behaviour to its figures: drives that excite it, and what their logs tell."""
