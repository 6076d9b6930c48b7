"""The page opens by itself, escapes what it is given, shows films, and is the same for the same data."""

import base64
import io
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from PIL import Image
from synthetic import attempt, audit, episodes, record

from craftsim.audit.audit import Audit, audit_rows
from craftsim.audit.audit_report import audit_report
from craftsim.checking.attempt import Verdict
from craftsim.checking.setup import Setup
from craftsim.experiments.statistics import campaign_figures
from craftsim.reports import html
from craftsim.reports.html import _poster, write_html
from craftsim.validation.report import runs_table, validation_report
from craftsim.validation.validation import Validation

pytestmark = pytest.mark.usefixtures("rendered_drawings")
EPISODES = episodes(n=30, actions=(2, 6))
HOSTILE = '</td><script>alert("x")</script><img src=http://a.b/c onerror=go()>{{ 7 * 7 }}$a_b$'
CONFIG = {
    "worlds": {"strip": "shipped"},
    "by": {"planner": "shipped"},
    "trials": 60,
    "noise": {"pose_m": 0.001},
    "rules": "published",
    "randomize": "none",
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
            value
            for name, value in attrs
            if name in ("src", "href", "xlink:href", "poster", "action")
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


def validate_report(out, records, config=CONFIG, command="craftsim validate strip"):
    result = Validation(records, campaign_figures(records, seed=0), config, 7)
    return validation_report(result, command)


def audited_report(out, records):
    figures, rows = campaign_figures(records, seed=0), tuple(audit_rows(records))
    return audit_report(Audit(records, rows, (), figures, CONFIG, 7, {}, None), "craftsim audit")


def page_of(out, report):
    return write_html(out, report).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    out = tmp_path_factory.mktemp("pages")
    return {
        "validate": page_of(out, validate_report(out, EPISODES)),
        "audit": page_of(out, audited_report(out, audit(contexts=40, trials=3))),
    }


@pytest.mark.parametrize("name", ["validate", "audit"])
def test_the_page_is_well_formed_and_asks_for_nothing_from_elsewhere(pages, name):
    reader, ids = Reader(pages[name]), set(re.findall(r'\bid="([^"]+)"', pages[name]))
    assert reader.open == []
    assert not {"script", "link", "iframe", "img", "object"} & set(reader.tags)
    assert all(address.startswith(("#", "data:")) for address in reader.addresses)
    assert {a[1:] for a in reader.addresses if a.startswith("#")} <= ids
    assert not re.search(r"url\((?!#)|@import", pages[name])
    assert "default-src 'none'" in pages[name]


def test_the_page_tells_what_decides_it_and_equal_data_give_equal_files(pages, tmp_path):
    text = Reader(pages["validate"]).text
    for word in (
        "place_m",
        "noise.pose_m",
        "craftsim validate strip",
        "mujoco",
        "mean maximum rank violation",
    ):
        assert word in text
    assert page_of(tmp_path, validate_report(tmp_path, EPISODES)) == pages["validate"]


def test_text_from_files_and_policies_is_escaped(tmp_path):
    bad = attempt(Verdict.FAILED, reason=HOSTILE, differences=[HOSTILE])
    extra = {"grid_success": True, "physics_success": False}
    records = [
        record(HOSTILE, bad, group=HOSTILE + str(i), bundle="b'; rm -rf ~; '", extra=extra)
        for i in range(3)
    ]
    records.append(record("late", error=HOSTILE, agrees=False))
    config = CONFIG | {"worlds": {HOSTILE: HOSTILE}, "by": {HOSTILE: HOSTILE}, HOSTILE: HOSTILE}
    reader = Reader(page_of(tmp_path, validate_report(tmp_path, records, config, HOSTILE)))
    assert not {"script", "img"} & set(reader.tags)
    assert reader.text.count(HOSTILE) > 10
    assert """craftsim replay 'b'"'"'; rm -rf ~; '"'"''""" in reader.text
    assert not {"script", "img"} & set(
        Reader(page_of(tmp_path, audited_report(tmp_path, records))).tags
    )


def _with_films(out, sizes):
    records = []
    for name, size in sizes.items():
        (out / name).mkdir(parents=True)
        (out / name / "film.mp4").write_bytes(name[-1].encode() * size)
        records.append(record(name, attempt(Verdict.FAILED), bundle=name, group=f"FOLD/{name}"))
    return records


def test_films_are_within_the_page_while_there_is_room_and_then_beside_it_but_none_of_elsewhere(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(html, "BUDGET_BYTES", 5000)
    out = tmp_path / "out"
    sizes = {"bundles/a": 3000, "bundles/big #1 b": 3000, "bundles/c": 300, "../elsewhere": 10}
    addresses = Reader(page_of(out, validate_report(out, _with_films(out, sizes)))).addresses
    films = [a for a in addresses if not a.startswith("#")]
    assert films == [
        "data:video/mp4;base64," + base64.b64encode(b"a" * 3000).decode(),
        "bundles/big%20%231%20b/film.mp4",
        "data:video/mp4;base64," + base64.b64encode(b"c" * 300).decode(),
    ]


FORBIDDEN = attempt(
    Verdict.FAILED,
    verb="LIFT",
    legal=False,
    performed=False,
    reason="the rules forbid it: no block",
)
FAILED = attempt(Verdict.FAILED)


def test_the_verdict_of_a_validation(tmp_path):
    for records, badge, sentence in (
        ([], "Nothing to judge", "No action was judged."),
        ([record("a", attempt())], "Agrees", "The run did"),
        ([record("a", FAILED)], "Disagrees", "In 1 of 1 run physics disagrees"),
        (
            [record("a", error="killed", agrees=False)],
            "Nothing to judge",
            "1 more trial did not finish.",
        ),
        (
            [record("a", attempt(), FORBIDDEN)],
            "Forbidden by the rules",
            "1 run asked for what the rules",
        ),
        (
            [record("a", FORBIDDEN), record("b", FAILED)],
            "Disagrees",
            "In 1 of 2 runs physics disagrees",
        ),
    ):
        headline = validate_report(tmp_path, records).headline
        assert headline.badge == badge
        assert sentence in headline.sentence


def test_the_table_of_runs_has_one_verdict():
    built = {"physics_success": True, "grid_success": True, "makespan_s": 2.0}
    missed = built | {"physics_success": False}
    runs = {
        "all": [record("a", attempt(), extra=built)],
        "some": [record("b", attempt(), extra=built), record("c", FAILED, extra=missed)],
        "none": [record("d", extra={}), record("e", error="killed", agrees=False)],
        "broken": [record("f", attempt(), FORBIDDEN)],
    }
    rows = []
    for group, records in runs.items():
        rows += [one | {"group": group} for one in records]
    table = runs_table(rows, "note")
    assert [(row[4].text, row[4].tone.value) for row in table.rows] == [
        ("as predicted, goal built", "good"),
        ("1 of 2 as predicted, goal built in 1 (by the rules in 2)", "bad"),
        ("1 without an action to judge, 1 without a result", "bad"),
        ("rules broken in 1 of 1", "caution"),
    ]
    assert [column.name for column in table.columns][-2:] == ["verdict", "makespan, s"]


def test_a_film_has_its_first_frame_as_a_poster(tmp_path):
    assert _poster(tmp_path / "gone.mp4") is None
    film = Path(__file__).parents[2] / "docs" / "gallery" / "films" / "strip.mp4"
    poster = _poster(film)
    data = base64.b64decode(poster.removeprefix("data:image/jpeg;base64,"))
    with Image.open(io.BytesIO(data)) as picture:
        assert picture.size == (640, 360)


def test_the_verdict_of_an_audit(tmp_path):
    for attempts, error, badge in (
        ([attempt()], None, "Sound"),
        ([FAILED], None, "Unsound"),
        ([attempt(legal=False)], None, "Not decided"),
        ([], "killed", "Not decided"),
    ):
        one = record("a", *attempts, group="LIFT/x", error=error)
        headline = audited_report(tmp_path, [one]).headline
        assert headline.badge == badge
        assert ("1 row is judged by too few trials" in headline.sentence) is bool(attempts)


def test_the_rows_of_an_audit_are_grouped_by_action_the_most_striking_first_with_their_films(
    tmp_path,
):
    results = {
        "FOLD/bundles/a": Verdict.FAILED,
        "FOLD/bundles/b": Verdict.UNSAFE,
        "LIFT/bundles/c": Verdict.SIDE_EFFECT,
        "LIFT/bundles/d": Verdict.AS_PREDICTED,
    }
    _with_films(tmp_path, {"bundles/a": 30, "bundles/c": 30})
    records = [
        record(name, attempt(result), group=name, bundle=name.partition("/")[2])
        for name, result in results.items()
    ]
    page = page_of(tmp_path, audited_report(tmp_path, records))
    assert [page.count(f"<summary>{title}") for title in ("FOLD: 2 of 2", "LIFT: 1 of 2")] == [1, 1]
    cards = re.findall(
        r"<h3>(\w+)/<wbr>bundles/<wbr>(\w)</h3>", page[: page.index("<summary>FOLD")]
    )
    assert cards == [("FOLD", "b"), ("LIFT", "c")]
    group = page[page.index("<summary>FOLD") : page.index("<summary>LIFT")]
    assert group.index("b</td>") < group.index("a</td>")
    assert group.count("<video") == 1
    assert "no film" not in group
