"""Files, links, verbs and pictures named on the pages exist."""

import re
import shlex

import pytest
from support.documents import BUILT, DOCS, README, ROOT, pages

from canopen_control.cli.support.parsers import parser_of
from canopen_control.cli.verbs import VERBS

MADE = tuple(f"docs/{name}" for name in BUILT[:2])
MADE_PAGES = {  # the keys of generate.PAGES, and what speed_history.py writes
    DOCS / "generated" / name
    for module, pattern in (("generate.py", r'^    "(\w+)\.md": \w+,$'), ("speed_history.py", r'folder / "(\w+)\.md"'))
    for name in re.findall(pattern, (DOCS / module).read_text(encoding="utf-8"), re.MULTILINE)
}
FOLDERS = "canopen_control|tests|tools|docs|config|eds"
PAGES = [pytest.param(path, id=str(path.relative_to(ROOT))) for path in pages()]
SUBPACKAGES = sorted(
    path.name for path in (ROOT / "canopen_control").iterdir() if path.is_dir() and path.name[0].isalpha()
)


def named_files(text):
    """Yield every path of this repository in a text; one that begins with a subpackage is the package's."""
    yield from re.findall(rf"(?<![\w/.-])(?:\./)?((?:{FOLDERS})/[\w./*-]*\w)", text)
    yield from (f"canopen_control/{path}" for path in re.findall(rf"`((?:{'|'.join(SUBPACKAGES)})/[\w/]+\.py)`", text))


def links(text):
    """Yield the targets of links and pictures that are files."""
    yield from re.findall(r"\]\((?!https?:|#)([^)#\s]+)", text)
    yield from re.findall(r"^```{literalinclude} (\S+)", text.replace("   ```", "```"), re.MULTILINE)


@pytest.mark.parametrize("path", PAGES)
def test_every_file_that_a_page_names_exists(path):
    text = path.read_text(encoding="utf-8")
    own = {"tests/cli/test_where.py"}  # of the reader's own verb
    expected = {name for name in named_files(text) if not name.startswith(MADE)}
    assert {name for name in expected if not any(ROOT.glob(name))} - own == set()


@pytest.mark.parametrize("path", PAGES)
def test_every_link_of_a_page_leads_somewhere(path):
    places = {target: (path.parent / target).resolve() for target in links(path.read_text(encoding="utf-8"))}
    created = DOCS / "generated"  # when the documentation is built, where a link that leads nowhere is an error
    assert [target for target, place in places.items() if place.parent != created and not place.exists()] == []


def test_every_page_is_in_a_table_of_contents_and_each_entry_is_a_page():
    """The build takes either for an error."""
    shown = set()
    for path in pages():
        for block in re.findall(r"```{toctree}\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL):
            shown |= {(path.parent / line).resolve() for line in block.split("\n") if line and line[0] not in ":"}
    own = {path.with_suffix("") for path in pages() if path.is_relative_to(DOCS)} - {DOCS / "index"}
    assert own | MADE_PAGES == shown


def test_the_readme_uses_verbs_that_exist_and_is_short():
    text = README.read_text(encoding="utf-8")
    assert set(re.findall(r"canopen-control ([a-z]+)", text)) <= set(VERBS)
    assert len(text.splitlines()) < 150


def complaint(command, capsys):
    """Return what the command line says against a command that a sentence names; a verb alone is a name."""
    verb, *words = shlex.split(command)
    if verb.startswith("-") or command == "VERB --help":
        return None
    if verb not in VERBS:
        return f"no verb {verb}"
    try:
        parser_of(verb).parse_args(words or ["--help"])
    except SystemExit as end:
        return capsys.readouterr().err if end.code else None
    return None


@pytest.mark.parametrize("path", PAGES)
def test_every_command_in_a_sentence_is_understood(path, capsys):
    """Those in blocks are run: tests/integration/test_examples.py."""
    text = re.sub(r"^`.*`$", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE)  # quoted messages hold some
    commands = re.findall(r"`canopen-control ([^`]+)`", text)
    assert [(command, message) for command in commands if (message := complaint(command, capsys))] == []


def test_the_answers_of_contributing_are_where_it_reports():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    answers = re.findall(r"^\| .*\? \| `(\w+)` \| `([\w/.]+)` \| `(\w+)` \|$", text, re.MULTILINE)
    assert len(answers) == 12
    for subpackage, file, name in answers:
        assert file.startswith(f"canopen_control/{subpackage}/")
        assert re.search(rf"^(class {name}\b|def {name}\(|{name}\b.* = )", (ROOT / file).read_text(), re.MULTILINE), (
            file
        )


def test_a_file_that_is_gone_would_be_seen():
    text = "`canopen_control/od/gone.py`, `bus/away.py`, ./tools/test and tests/od/malformed"
    assert sorted(name for name in named_files(text) if not any(ROOT.glob(name))) == [
        "canopen_control/bus/away.py",
        "canopen_control/od/gone.py",
    ]
