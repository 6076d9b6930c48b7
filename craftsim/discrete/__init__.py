"""The grid world: actions, grid, rules, blueprints, plans, and reading a grid from poses. Never imports MuJoCo."""
