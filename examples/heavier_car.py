"""Does the building still stand with a heavier car? Build it with the shipped machines and with my own.

The same from a shell:  craftsim demo strip --machines heavier_car.yaml
"""

from pathlib import Path

import craftsim

FILE = Path(__file__).parent / "heavier_car.yaml"

mass = craftsim.load_machines(FILE).car(0).mass_kg
print(f"the car weighs {mass:.2f} kg instead of {craftsim.SmartcarParameters().mass_kg:.2f} kg")

for name, machines in {"shipped": None, "heavier": FILE}.items():
    result = craftsim.validate("strip", machines=machines, randomize="none", trials=1)
    actions = result.to_frame()
    print(
        f"{name}: {actions.result.str.startswith('as predicted').sum()} of {len(actions)} actions as predicted, "
        f"{actions.duration_s.sum():.0f} s of work, largest error {1e3 * actions.car_error_m.max():.2f} mm"
    )
