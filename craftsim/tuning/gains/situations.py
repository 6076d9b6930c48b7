"""The situations in which gains are tried: single actions, each where another gain matters."""

from __future__ import annotations

from typing import Final

from craftsim.audit.situation import Row, shipped
from craftsim.audit.survey import row_of
from craftsim.tuning.gains.knobs import SUBJECTS, Subject

_SECTIONS: Final = {section: tuple(map(row_of, said)) for section, said in shipped("tuning.yaml").items()}
"""Those of ``craftsim/data/tuning.yaml``, by the section of the gains."""


def situations(subject: Subject) -> tuple[Row, ...]:
    """Return the situations in which the gains of a subject are tried."""
    return tuple(row for section in SUBJECTS[subject] for row in _SECTIONS[section])
