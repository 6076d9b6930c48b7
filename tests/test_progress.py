"""Long work says what it does after two seconds, also into a file; the remaining time comes late, and is steady."""

import pytest

from craftsim.cli import progress


def test_a_line_comes_before_the_first_result(monkeypatch, capsys):
    monkeypatch.setattr(progress, "_FIRST_LINE_S", 0.01)
    with progress.counting("runs")(10):
        for _ in range(1000):
            if said := capsys.readouterr().out:
                break
            progress.time.sleep(0.01)
    assert said.startswith("runs: 0 of 10")


def test_work_that_counts_nothing_says_what_it_is(monkeypatch, capsys):
    monkeypatch.setattr(progress, "_FIRST_LINE_S", 0.01)
    with progress.working("replay a[b]"):
        for _ in range(1000):
            if said := capsys.readouterr().out:
                break
            progress.time.sleep(0.01)
    assert said == "replay a[b]\n"


def test_the_remaining_time_is_said_from_a_tenth_of_the_work_on(monkeypatch):
    lines = []
    clock = iter([0.0, 100.0, 101.0, 102.0])

    class Display:
        def __init__(self, *_):
            pass

        def __enter__(self):
            return lambda done, status, line: lines.append(line)

        def __exit__(self, *_):
            return None

    monkeypatch.setattr(progress, "progress_of", Display)
    monkeypatch.setattr(progress.time, "perf_counter", lambda: next(clock))
    with progress.counting("runs")(24) as tell:
        for agrees in (True, True, False):
            tell({"agrees": agrees})
    assert lines == [
        "1 of 24, 0 failed, 100 s each",
        "2 of 24, 0 failed, 50 s each",
        "3 of 24, 1 failed, 34 s each, about 800 s left",
    ]


@pytest.mark.parametrize(("seconds", "shown"), [(0.2, 0), (7.6, 8), (12, 20), (740, 800)])
def test_the_remaining_time_has_one_digit(seconds, shown):
    assert progress._rounded(seconds) == shown
