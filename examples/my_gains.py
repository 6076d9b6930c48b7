"""What do my gains change? Run a shipped plan with the shipped gains and with my own, and compare the two.

The same from a shell:  craftsim validate strip --gains my_gains.yaml
"""

from pathlib import Path

import craftsim

MINE = Path(__file__).parent / "my_gains.yaml"

for name, gains in {"shipped gains": None, "my gains": MINE}.items():
    result = craftsim.validate("strip", gains=gains, randomize="none", trials=1)
    moves = result.to_frame().query("verb == 'MOVE'")
    print(
        f"{name}: a move takes {moves.duration_s.median():.2f} s, "
        f"ends within {1e3 * moves.car_error_m.max():.2f} mm, "
        f"and its contacts stay below {moves.peak_force_n.max():.0f} N; agrees: {result.agrees}"
    )
