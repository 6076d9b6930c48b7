"""Which neighbours matter to an action: swept volumes from the machines' geometry, and what the rules make of them."""
