"""The documents: every relative link and picture resolves, the README is short, and every page is linked."""

import csv
import re
import tomllib
from pathlib import Path

import pytest
import yaml

import linkplan
from linkplan.studies.handover.export.formats import FORMATS

ROOT = Path(__file__).resolve().parent.parent
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]
# Three screens of some forty-five lines.
MOST_LINES = 140
# What a line of a block shows of itself on the site, in characters.
WIDTH = 102
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


def links(page: Path) -> list[str]:
    """Return the targets of a page's links and pictures, those within the project alone."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return [target for target in LINK.findall(text) if not re.match(r"[a-z]+:", target)]


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings."""
    heads = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def test_there_are_pages_with_links():
    assert len(PAGES) > 8
    assert sum(len(links(page)) for page in PAGES) > 40


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_relative_links_and_pictures_resolve(page):
    for target in links(page):
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), target
        assert there.is_relative_to(ROOT), target
        assert not anchor or anchor in anchors(there), target


def test_the_readme_fits_three_screens():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= MOST_LINES


def test_every_page_of_docs_is_linked_from_the_readme_or_from_the_list_of_pages():
    linked = {
        (page.parent / target).resolve()
        for page in (ROOT / "README.md", ROOT / "docs" / "index.md")
        for target in links(page)
    }
    pages = {*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "notebooks").glob("*.py")}
    assert pages - {ROOT / "docs" / "index.md"} <= linked


def test_every_page_stands_in_the_tables_of_contents_of_the_site():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    listed = set(" ".join(re.findall(r"^```\{toctree\}\n(.*?)^```", index, flags=re.MULTILINE | re.DOTALL)).split())
    pages = [*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "notebooks").glob("*.py")]
    assert {str(page.relative_to(ROOT / "docs").with_suffix("")) for page in pages} - {"index"} <= listed


def test_the_page_on_python_has_every_public_name_and_no_other():
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    told = set(re.findall(r":: linkplan\.(\w+)(?:\(\))?$", page, flags=re.MULTILINE))
    assert told == set(linkplan.__all__) - {"LinkplanError"}
    assert "linkplan.models.errors" in page


def test_every_format_of_export_stands_beside_the_command():
    page = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"^linkplan export .*$", page, flags=re.MULTILINE)
    assert set(FORMATS) <= set(re.findall(r"\w+", line))


def test_blocks_of_commands_are_read_without_scrolling():
    """A block of the site shows some hundred characters; a command itself may be longer, what explains it may not."""
    page = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    lines = "".join(re.findall(r"^```sh\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)).splitlines()
    assert [line for line in lines if "#" in line and len(line) > WIDTH] == []


def test_the_citation_names_this_version_and_licence():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {"cff-version", "message", "title", "authors"} <= set(cited)
    assert all({"name"} <= set(author) or {"family-names", "given-names"} <= set(author) for author in cited["authors"])
    assert (str(cited["version"]), cited["license"]) == (project["version"], project["license"])


def test_the_counts_of_robots_on_the_page_of_measurements_follow_from_their_table():
    with (ROOT / "docs" / "data" / "robots.csv").open(encoding="utf-8", newline="") as file:
        robots = list(csv.DictReader(file))
    planned = [robot for robot in robots if robot["plan [s]"]]
    assert [robot["model"] for robot in robots if not robot["plan [s]"] and not robot["note"]] == []
    assert all(robot["freedoms"] == robot["by MuJoCo"] for robot in planned)
    page = (ROOT / "docs" / "measured.md").read_text(encoding="utf-8")
    assert f"lists {len(robots)} published robots" in page
    assert f"equal to MuJoCo's for all {len(planned)}" in page


def test_terms_of_the_glossary_stand_once_and_in_order():
    terms = re.findall(r"^\*\*([^*]+)\*\*", (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert len(terms) > 40
    assert terms == sorted(set(terms), key=str.lower)


def test_recipes_are_shorter_than_thirty_lines():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    recipes = re.findall(r"^## (Add an? [^\n]*)\n(.*?)(?=^## |\Z)", text, flags=re.MULTILINE | re.DOTALL)
    assert len(recipes) == 8
    for title, body in recipes:
        assert len(body.strip().splitlines()) < 30, title


def quoted_in_contributing() -> list[str]:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return sorted(set(re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))))


def test_files_that_the_guide_for_developers_names_exist():
    files = [quoted for quoted in quoted_in_contributing() if re.fullmatch(r"[a-z_/]+/[a-z_]+\.(py|md|toml)", quoted)]
    assert len(files) > 20
    assert [file for file in files if not (ROOT / file).is_file()] == []


def test_names_that_the_guide_for_developers_quotes_stand_in_the_code():
    """Of functions, classes, constants and modules; a name that the code has lost sends a reader astray."""
    folders = ("models", "planner", "controllers", "studies", "tests")
    paths = [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]
    code = "\n".join(
        [*(path.read_text(encoding="utf-8") for path in paths), *(str(path.relative_to(ROOT)) for path in paths)]
    )
    names = [quoted for quoted in quoted_in_contributing() if re.fullmatch(r"_?[A-Za-z]\w*(\.[a-z_]+)?(\(\))?", quoted)]
    assert len(names) > 100
    lost = [name for name in names if not re.search(rf"\b{re.escape(name.removesuffix('()').split('.')[-1])}\b", code)]
    assert lost == []
