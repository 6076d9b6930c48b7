"""The audit of the rules: where they allow and where they forbid, tried in physics."""
