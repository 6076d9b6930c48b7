"""Results of builders, one JSON object a line: written by the server, checked by playing the answers again.

    python check_results.py results.jsonl

Anybody can add rows: a run of all 30 designs, with the answers in it. Physics repeats a row bit for bit on one machine
and with the versions that it names; elsewhere a figure may differ.
"""

import json
import sys
from pathlib import Path

from craftsim.envs.text_designs import chosen_rows, design_world, score

FIGURES = ("built", "in_place", "turns", "predicted", "allowed", "acted", "unreadable")
DESIGNS = [(name, row) for name, rows in chosen_rows().items() for row in rows]
"""Difficulty and held-out start of each of the 30 designs."""


def add(path, result):
    """Add a row to a file of results."""
    with Path(path).open("a", encoding="utf-8") as file:
        file.write(json.dumps(result) + "\n")


def read(path):
    """Return the rows of a file of results."""
    lines = Path(path).read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines]


def play_again(result):
    """Return the figures that the answers of a row lead to."""
    _, row = DESIGNS[result["design"]]
    env = design_world(row, result["backend"])
    env.reset(seed=result["seed"])
    turns = []
    for answer in result["answers"]:
        exchange, _, _, _, info = env.turn(answer)
        turns.append(exchange)
    figures = score(env, turns, bool(turns and info["success"]))
    env.close()
    return figures


def main(path):
    """Play each row again, print what each builder came to, and return how many rows differ."""
    results = read(path)
    n_different = 0
    for number, result in enumerate(results, 1):
        figures = play_again(result)
        for name in FIGURES:
            if result[name] != figures[name]:
                n_different += 1
                print(f"{path}:{number}: {name} is {figures[name]}, not {result[name]}")
                break
    for builder in dict.fromkeys(result["builder"] for result in results):
        rows = [result for result in results if result["builder"] == builder]
        n_built = sum(row["built"] for row in rows)
        n_designs = len({row["design"] for row in rows})
        print(f"{builder}: {n_built} built in {len(rows)} episodes of {n_designs} designs")
    return n_different


if __name__ == "__main__":
    sys.exit(min(main(sys.argv[1]), 1))
