"""Records made up from a seed, shaped like those of a campaign, for tests of what is made of them."""

import numpy as np

from craftsim.checking.attempt import Verdict
from craftsim.checking.measurements import MEASUREMENTS

VERBS = ("LIFT", "DROP", "FOLD", "UNFOLD", "ROTATE_LEFT", "ROTATE_RIGHT", "MOVE", "STOP")
SECONDS = dict(zip(VERBS, (0.7, 0.7, 11.0, 11.0, 0.9, 0.9, 0.95, 0.04), strict=True))
REASONS = {
    Verdict.FAILED: "blocked: 41 mm behind the path",
    Verdict.SIDE_EFFECT: "block 3 was moved by 12.4 mm (allowed 1.0)",
    Verdict.UNSAFE: "car 0 tipped by 0.6 rad; slope 0 touched car 1 (212 N)",
    Verdict.NUMERICS: "the solver did not converge in 2 physics steps",
}


def attempt(result=Verdict.AS_PREDICTED, *, legal=True, performed=True, verb="MOVE", **changes):
    """Return an attempt with figures that are easy to recognise."""
    return {
        "tick": 0,
        "car": 0,
        "action": "MOVE_FORWARD" if verb == "MOVE" else verb,
        "verb": verb,
        "level": 1,
        "load": "none",
        "slope": False,
        "legal": legal,
        "performed": performed,
        "result": str(result),
        "finding": "agrees" if result == Verdict.AS_PREDICTED else "wrong place",
        "skill": "succeeded",
        "reason": REASONS.get(result, ""),
        "differences": []
        if result == Verdict.AS_PREDICTED
        else ["car 0: predicted 1,1,1 +x, read 0,1,1 +x"],
        "predicted": "1,1,1 +x",
        "read": "1,1,1 +x" if result == Verdict.AS_PREDICTED else "0,1,1 +x",
        "start_s": 0.3,
        **{row.name: None if row.of == "thing" else 0 for row in MEASUREMENTS.values()},
        "car_error_m": 0.0002,
        "heading_error_rad": 0.001,
        "height_error_m": 0.0001,
        "tilt_error_rad": 0.001,
        "duration_s": 1.0,
        "peak_force_n": 20.0,
        "capped_steps": 0,
        "tries": 1,
        **changes,
    }


def record(key, *attempts, group="plan", agrees=None, **changes):
    """Return the record of a trial."""
    good = all(a["result"] == Verdict.AS_PREDICTED for a in attempts)
    return {
        "key": key,
        "index": 0,
        "group": group,
        "seed": 0,
        "context": None,
        "episode": None,
        "attempts": list(attempts),
        "agrees": good if agrees is None else agrees,
        "error": None,
        "bundle": None,
        "extra": {},
        **changes,
    }


def drawn_attempt(rng, verb, works, *, legal=True):
    """Return an attempt that does as predicted with a probability of ``works``."""
    bad = (Verdict.FAILED, Verdict.SIDE_EFFECT, Verdict.UNSAFE)
    result = Verdict.AS_PREDICTED if rng.random() < works else bad[rng.choice(3, p=(0.7, 0.2, 0.1))]
    names = (
        "car_error_m",
        "heading_error_rad",
        "height_error_m",
        "bystander_displacement_m",
        "placed_error_m",
    )
    errors = dict(zip(names, rng.gamma(2.0, (8e-5, 3e-4, 5e-5, 3e-5, 2e-4)).tolist(), strict=True))
    if verb not in ("DROP", "FOLD", "UNFOLD"):
        errors["placed_error_m"] = None
    level, load, slope = int(rng.integers(1, 4)), str(rng.choice(("none", "block"))), verb == "MOVE"
    numbers = {
        "duration_s": float(SECONDS[verb] * rng.normal(1.0, 0.04)),
        "peak_force_n": rng.gamma(4.0, 12.0),
    }
    kind = {"verb": verb, "level": level, "load": load, "slope": slope and bool(rng.random() < 0.3)}
    return attempt(result, legal=legal, **kind, **errors, **numbers)


def episodes(seed=0, n=60, policies=("random", "planner", "ippo", "qmix"), actions=(12, 40)):
    """Return records of episodes of several policies, some of which disagree or end in an error."""
    rng = np.random.default_rng(seed)
    records = []
    for index in range(n):
        which = index % len(policies)
        works = 0.98 - 0.012 * which
        verbs = [str(verb) for verb in rng.choice(VERBS, int(rng.integers(*actions)))]
        attempts = [
            drawn_attempt(rng, verb, works) | {"tick": tick} for tick, verb in enumerate(verbs)
        ]
        grid = bool(rng.random() < 0.9 - 0.2 * which)
        extra = {"grid_success": grid, "physics_success": grid and bool(rng.random() < 0.8)}
        about = {"group": policies[which], "index": index, "episode": index, "extra": extra}
        entry = record(f"{policies[which]}/{index}", *attempts, **about)
        if not entry["agrees"]:
            entry["bundle"] = f"bundles/{policies[which]}-{index}"
        if index % 29 == 28:
            entry |= {
                "attempts": [],
                "agrees": False,
                "error": "TimeoutError: longer than 60 s",
                "bundle": None,
            }
        records.append(entry)
    return records


def audit(seed=0, contexts=60, trials=20):
    """Return records of an audit, with rows of every verdict."""
    rng = np.random.default_rng(seed)
    records = []
    for row in range(contexts):
        verb = VERBS[row % len(VERBS)]
        legal = row % 3 != 2
        works = (0.1 if row % 11 == 0 else 1.0) if legal else (1.0 if row % 17 == 2 else 0.05)
        group = f"{verb}/level={row % 3 + 1}/ground=flat/own=air/load=none/next=fslope-left/room=free/row={row}"
        if not legal and row % 5 == 0:
            records.append(record(f"{group}#0", group=group, context=group, agrees=False))
            continue
        for index in range(trials):
            about = {"group": group, "context": group, "index": len(records)}
            entry = record(
                f"{group}#{index}", drawn_attempt(rng, verb, works, legal=legal), **about
            )
            if legal is not entry["agrees"] and index < 2:
                entry["bundle"] = f"bundles/row-{row}-{index}"
            records.append(entry)
    return records
