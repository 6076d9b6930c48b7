"""The page opens by itself, escapes what it is given, shows films, and is the same for the same data."""

import base64
import re
import shutil
from html.parser import HTMLParser
from types import SimpleNamespace

import pytest
from synthetic import attempt, audit, episodes, record

from craftsim.checking.attempt import Verdict
from craftsim.checking.episode import Recipe, Step, do, start
from craftsim.checking.setup import Setup
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.experiments.experiment import Item
from craftsim.experiments.statistics import campaign_figures
from craftsim.rendering.trajectory import TRAJECTORIES, Recorder
from craftsim.reports import html
from craftsim.reports.html import write_html
from craftsim.validation.audit.audit import Audit
from craftsim.validation.audit.report import audit_report
from craftsim.validation.audit.results import Results, judged_by_rules
from craftsim.validation.report import validation_report
from craftsim.validation.validation import Validation

HOSTILE = '</td><script>alert("x")</script><img src=http://a.b/c onerror=go()>{{ 7 * 7 }}$a_b$'
CONFIG = {
    "worlds": {"strip": "shipped"},
    "by": {"planner": "shipped"},
    "trials": 60,
    "noise": {"pose_m": 0.001},
    "rules": "published",
    "setup": Setup(),
}


class Reader(HTMLParser):
    """Collects tags, addresses and text of a page, and whether its tags are balanced."""

    VOID = frozenset({"meta", "link", "img", "br", "wbr", "hr", "input", "source"})

    def __init__(self, text):
        super().__init__()
        self.tags, self.addresses, self.words, self.open = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [
            value for name, value in attrs if name in ("src", "href", "xlink:href", "poster", "action")
        ]
        assert not any(name.startswith("on") for name, _ in attrs)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self):
        return "".join(self.words)


def validate_html(out, records, config=CONFIG, command="craftsim validate strip"):
    result = Validation(records, campaign_figures(records, seed=0), config, 7, ())
    return write_html(out, validation_report(result, out, command)).read_text(encoding="utf-8")


def audit_html(out, records):
    figures = campaign_figures(judged_by_rules(records), seed=0)
    result = Audit(records, Results.of(records), figures, CONFIG, 7, {}, None)
    return write_html(out, audit_report(result, out, "craftsim audit")).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    out = tmp_path_factory.mktemp("pages")
    return {"validate": validate_html(out, episodes(n=30)), "audit": audit_html(out, audit(contexts=40))}


@pytest.mark.parametrize("name", ["validate", "audit"])
def test_the_page_is_well_formed_and_asks_for_nothing_from_elsewhere(pages, name):
    reader = Reader(pages[name])
    assert reader.open == []
    assert not {"script", "link", "iframe", "img", "object"} & set(reader.tags)
    assert all(address.startswith(("#", "data:")) for address in reader.addresses)
    assert not re.search(r"url\((?!#)|@import", pages[name])
    assert "default-src 'none'" in pages[name]


@pytest.mark.parametrize("name", ["validate", "audit"])
def test_addresses_within_the_page_lead_somewhere(pages, name):
    ids = set(re.findall(r'\bid="([^"]+)"', pages[name]))
    assert {a[1:] for a in Reader(pages[name]).addresses if a.startswith("#")} <= ids


def test_the_verdict_comes_first_then_the_matrix_then_the_disagreements(pages):
    text = Reader(pages["audit"]).text
    order = (
        "that the rules allow are unsound",
        "Legality and result",
        "and physics refuses. First",
        "Sound: ",
    )
    places = [text.rindex(words) for words in (*order, "Thresholds")]
    assert places == sorted(places)


def test_the_page_tells_what_decides_it(pages):
    text = Reader(pages["validate"]).text
    for word in ("car_m", "noise.pose_m", "craftsim validate strip", "mujoco", "mean maximum rank violation"):
        assert word in text


def test_equal_data_give_equal_files(tmp_path):
    assert validate_html(tmp_path / "a", episodes(n=8)) == validate_html(tmp_path / "b", episodes(n=8))


def test_text_from_files_and_policies_is_escaped(tmp_path):
    bad = attempt(Verdict.FAILED, reason=HOSTILE, differences=[HOSTILE])
    extra = {"grid_success": True, "physics_success": False}
    records = [
        record(HOSTILE, bad, group=HOSTILE + str(i), bundle="b'; rm -rf ~; '", extra=extra) for i in range(3)
    ]
    records.append(record("late", error=HOSTILE, agrees=False))
    config = CONFIG | {"worlds": {HOSTILE: HOSTILE}, "by": {HOSTILE: HOSTILE}, HOSTILE: HOSTILE}
    reader = Reader(validate_html(tmp_path, records, config, HOSTILE))
    assert not {"script", "img"} & set(reader.tags)
    assert reader.text.count(HOSTILE) > 10
    assert """craftsim replay 'b'"'"'; rm -rf ~; '"'"''""" in reader.text

    reader = Reader(audit_html(tmp_path, records))
    assert not {"script", "img"} & set(reader.tags)


def _with_films(out, sizes):
    records = []
    for name, size in sizes.items():
        (out / name).mkdir(parents=True)
        (out / name / "film.mp4").write_bytes(name[-1].encode() * size)
        records.append(record(name, attempt(Verdict.FAILED), bundle=name))
    return records


def test_films_are_within_the_page_while_there_is_room_and_then_beside_it(tmp_path, monkeypatch):
    monkeypatch.setattr(html, "BUDGET_BYTES", 5000)
    records = _with_films(tmp_path, {"bundles/a": 3000, "bundles/big #1 b": 3000, "bundles/c": 300})
    addresses = Reader(validate_html(tmp_path, records)).addresses
    films = [a for a in addresses if not a.startswith("#")]
    assert films == [
        "data:video/mp4;base64," + base64.b64encode(b"a" * 3000).decode(),
        "bundles/big%20%231%20b/film.mp4",
        "data:video/mp4;base64," + base64.b64encode(b"c" * 300).decode(),
    ]


def test_a_film_outside_of_the_page_s_folder_is_not_taken_in(tmp_path):
    _with_films(tmp_path, {"elsewhere": 10})
    records = [record("a", attempt(Verdict.FAILED), bundle="../elsewhere")]
    assert "data:video" not in validate_html(tmp_path / "out", records)


@pytest.mark.parametrize(
    ("records", "badge"),
    [
        ([], "Nothing to judge"),
        ([record("a", attempt())], "Agrees"),
        ([record("a", attempt(Verdict.FAILED))], "Disagrees"),
        ([record("a", error="killed", agrees=False)], "Nothing to judge"),
    ],
)
def test_the_badge_of_a_validation(tmp_path, records, badge):
    assert f'<span class="verdict">{badge}</span>' in validate_html(tmp_path, records)


FORBIDDEN = {"legal": False, "performed": False, "reason": "the rules forbid it: no block in the cell"}


def test_what_the_rules_forbid_and_was_not_tried_is_no_disagreement_of_physics(tmp_path):
    records = [record("a", attempt(), attempt(Verdict.FAILED, verb="LIFT", **FORBIDDEN))]
    page = validate_html(tmp_path, records)
    assert '<span class="verdict">Forbidden by the rules</span>' in page
    text = Reader(page).text
    assert "physics disagrees" not in text
    assert "1 run asked for what the rules forbid, which was not tried." in text
    assert "tried on purpose" not in text
    assert FORBIDDEN["reason"] in text


def test_tables_have_no_negative_zero_and_no_figures_of_nothing(tmp_path):
    tiny = {"heading_error_rad": -1e-12, "height_error_m": -1e-12, "car_error_m": 0.0}
    page = validate_html(tmp_path / "tiny", [record("a", attempt(**tiny), attempt(duration_s=0.999))])
    assert not re.search(r"-0\.0+\b", Reader(page).text.split("Thresholds and provenance")[0])
    text = Reader(validate_html(tmp_path / "none", [record("a", attempt(Verdict.FAILED))])).text
    assert "car's error, median" not in text
    assert not re.search(r"median 0(\.0+)? mm", text)


def test_what_the_rules_forbid_does_not_hide_where_physics_disagrees(tmp_path):
    records = [
        record("a", attempt(Verdict.FAILED, verb="LIFT", **FORBIDDEN)),
        record("b", attempt(Verdict.FAILED)),
    ]
    text = Reader(validate_html(tmp_path, records)).text
    assert "In 1 of 2 runs physics disagrees with the rules" in text
    assert "1 run asked for what the rules forbid" in text


@pytest.mark.parametrize(
    ("records", "badge"),
    [
        ([record("a", attempt(), group="LIFT/x")], "Sound"),
        ([record("a", attempt(Verdict.FAILED), group="LIFT/x")], "Unsound"),
        ([record("a", attempt(legal=False), group="LIFT/x")], "Not decided"),
        ([record("a", group="LIFT/x", error="killed")], "Not decided"),
    ],
)
def test_the_badge_of_an_audit(tmp_path, records, badge):
    assert f'<span class="verdict">{badge}</span>' in audit_html(tmp_path, records)


def test_all_disagreements_are_on_the_page(tmp_path):
    records = [record(f"run-{i}-end", attempt(Verdict.FAILED), bundle=f"bundles/{i}") for i in range(40)]
    text = Reader(validate_html(tmp_path, records)).text
    assert all(f"run-{i}-end" in text for i in range(40))
    assert "Failures: 40" in text


def test_the_rows_of_an_audit_are_grouped_by_action_the_most_striking_first(tmp_path):
    results = {
        "FOLD/a": Verdict.FAILED,
        "FOLD/b": Verdict.UNSAFE,
        "LIFT/c": Verdict.SIDE_EFFECT,
        "LIFT/d": None,
    }
    records = [
        record(name, attempt(result or Verdict.AS_PREDICTED), group=name, bundle=f"bundles/{name[-1]}")
        for name, result in results.items()
    ]
    page = audit_html(tmp_path, records)
    assert [page.count(f"<summary>{title}") for title in ("FOLD: 2 of 2", "LIFT: 1 of 2")] == [1, 1]
    cards = re.findall(r"<h3>(\w+)/<wbr>(\w)</h3>", page)
    assert cards == [("FOLD", "b"), ("LIFT", "c")]
    group = page[page.index("<summary>FOLD") :]
    assert group.index(">b</td>") < group.index(">a</td>")


def test_films_stand_in_the_group_of_their_action(tmp_path):
    records = _with_films(tmp_path, {"bundles/a": 30, "bundles/b": 30})
    for entry in records:
        entry["group"] = f"FOLD/{entry['key']}"
    page = audit_html(
        tmp_path, [*records, record("c", attempt(Verdict.FAILED), group="FOLD/c", bundle="bundles/c")]
    )
    group = page[page.index("<summary>FOLD: 3 of 3") :]
    assert group.count("<video") == 2
    assert "no film" not in group


def _recorded(out, names):
    """Return items and records of runs that were recorded; the last one disagrees."""
    grid = Grid.empty((2, 1, 1), n_cars=1)
    recipe, recorder = Recipe(blueprint_text(grid), (Step.single(0, 0, Action.MOVE_RIGHT),)), Recorder()
    judge = start(recipe)
    recorder.begin(judge)
    attempts = do(judge, recipe.steps[0])
    (out / TRAJECTORIES).mkdir(parents=True)
    items, records = [], []
    for name in names:
        recorder.trajectory(HOSTILE, recipe, attempts).write(out / TRAJECTORIES / f"{name}.npz")
        job = SimpleNamespace(file_name=name, terms=SimpleNamespace(record=True))
        items.append(Item(f"<b>{name}", "planner", 0, job))
        records.append(record(name, attempt(Verdict.FAILED if name == names[-1] else Verdict.AS_PREDICTED)))
        records[-1]["agrees"] = name != names[-1]
    return items, records


def _page_of(out, items, records):
    result = Validation(records, campaign_figures(records, seed=0), CONFIG, 7, items)
    return write_html(out, validation_report(result, out, "craftsim validate")).read_text(encoding="utf-8")


def test_recorded_runs_are_drawn_those_first_that_disagree(tmp_path, monkeypatch):
    monkeypatch.setattr("craftsim.validation.sections.MOST_RUNS", 1)
    page = _page_of(tmp_path, *_recorded(tmp_path, ["one", "two"]))
    reader = Reader(page)
    section = page[page.index('<section id="recorded">') :]
    titles = re.findall(r"<summary>(.*?)</summary>", section[: section.index("</section>")])
    assert titles == ['&lt;b&gt;two <span class="badge">disagrees</span>']
    assert all(address.startswith(("#", "data:")) for address in reader.addresses)
    assert section[: section.index("</section>")].count("<svg") == 5
    assert "2 recorded runs" in reader.text


def test_a_damaged_trajectory_is_told_and_does_not_keep_the_page_from_being_written(tmp_path):
    items, records = _recorded(tmp_path, ["one"])
    (tmp_path / TRAJECTORIES / "one.npz").write_bytes(b"PK")
    assert "No figures: " in Reader(_page_of(tmp_path, items, records)).text


def test_the_disagreements_of_an_audit_that_were_recorded_are_drawn_and_linked(tmp_path, monkeypatch):
    monkeypatch.setattr("craftsim.validation.sections.MOST_RUNS", 2)
    _recorded(tmp_path, ["one"])
    results = {
        "LIFT/a": Verdict.FAILED,
        "LIFT/b": Verdict.FAILED,
        "FOLD/c": Verdict.UNSAFE,
        "LIFT/d": Verdict.FAILED,
    }
    bundles = {name: f"bundles/{name[-1]} 1" for name in results}
    for name in ("LIFT/a", "LIFT/b", "FOLD/c"):
        (tmp_path / bundles[name]).mkdir(parents=True)
        shutil.copy(tmp_path / TRAJECTORIES / "one.npz", tmp_path / bundles[name] / "trajectory.npz")
    page = audit_html(
        tmp_path,
        [record(name, attempt(result), group=name, bundle=bundles[name]) for name, result in results.items()],
    )
    section = page[page.index('<section id="recorded">') :]
    section = section[: section.index("</section>")]
    assert re.findall(r"<summary>(\w+)/<wbr>(\w)", section) == [("FOLD", "c"), ("LIFT", "a")]
    assert section.count("<svg") == 10
    assert "3 recorded runs" in section
    links = [address for address in Reader(page).addresses if address.endswith("trajectory.npz")]
    assert links.count("bundles/b%201/trajectory.npz") == 1, "in the table of all"
    assert links.count("bundles/c%201/trajectory.npz") == 2, "beside the command, too"
    assert not any("/d" in link for link in links)
    assert "craftsim render &#39;bundles/<wbr>c 1/<wbr>trajectory.npz&#39;" in page


def test_what_is_folded_on_a_screen_is_open_on_paper_and_no_table_is_cut(pages):
    printed = pages["audit"][pages["audit"].index("@media print") :]
    for rule in ("details::details-content", "overflow: visible", "break-inside: avoid-page"):
        assert rule in printed
    assert "@media screen and (prefers-color-scheme: dark)" in pages["audit"]
