"""Writes the documentation site, out/site, from README.md, docs/ and site/pages.

If SITE_URL contains the site's address, a sitemap is written as well, and pages have preview pictures. If
SITE_REPOSITORY contains the repository's address, pages link to it and to its files.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

from conf import REPOSITORY
from gallery import gallery
from home import home
from moved import MOVED
from shift_curves import shift_curves
from standings_page import standings_page
from task_pages import write_task_pages
from wrong_goals import wrong_goals

from magical_mj.actions import ACTIONS
from magical_mj.leaderboard.rerun import rerun, stored_policies
from magical_mj.leaderboard.standings import Standing, standing
from magical_mj.web.page_data import drawing_style
from tools.scores import by_released_rules, own_methods
from tools.stored_episodes import RESULTS

ROOT: Final = Path(__file__).parent.parent
PAGES: Final = ROOT / "site" / "pages"
SOURCES: Final = ROOT / "out" / "site-sources"
FOLDER: Final = ROOT / "out" / "site"
PLACEHOLDER: Final = re.compile(r"^<!-- (README|file|actions|home): ?(.*?) -->$", re.MULTILINE)
LINK: Final = re.compile(r"\[([^]]*)\]\((?!https?:|#)([\w./-]+)(#[\w-]*)?\)")
PLAYED: Final = re.compile(r"`(play/[^` ]*)`")
"""The address of a page to play on."""
MISSING: Final = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>No such page · magical_mj</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><meta name="color-scheme" content="light dark">
<style>body {{ font: 1.1rem/1.5 system-ui, sans-serif; max-width: 32rem; margin: 12vh auto; padding: 0 1rem }}
svg {{ width: 7rem }} nav {{ display: flex; flex-wrap: wrap; gap: .6rem }} a {{ color: inherit; padding: .3rem .9rem;
border: 2px solid #2f6f92; border-radius: .5rem }}</style>{base}</head><body>{logo}<h1>This page does not exist</h1>
<p>It may have been renamed. These pages exist:</p><nav><a href="index.html">Home</a> <a href="tasks.html">Tasks</a>
<a href="standings.html">Leaderboard</a> <a href="play/">Play</a> <a href="search.html">Search</a></nav></body></html>
"""
"""The page that web hosts show, under any address, instead of a page that does not exist."""
FIND_BASE: Final = """<script type="module">  // without a known address, the site's folder is the one with objects.inv
for (let folder = new URL(".", location); ; folder = new URL("..", folder)) {
  const reply = await fetch(new URL("objects.inv", folder), { method: "HEAD" }).catch(() => null);
  if (reply?.ok) document.head.append(Object.assign(document.createElement("base"), { href: folder }));
  if (reply?.ok || folder.pathname === "/") break;
}
</script>"""
FIXES: Final = {
    '<p class="caption" role="heading">': '<p class="caption" role="heading" aria-level="2">',
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="All pages">',
    '<aside class="toc-drawer': '<aside aria-label="This page" class="toc-drawer',
    '<th class="head"><p></p></th>': '<td class="head"></td>',
}
"""HTML of the theme and of Markdown's tables that is not accessible to screen readers -> its replacement."""
REPOSITORY_FILES: Final = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
}


def write_docs(folder: Path) -> None:
    """Collects all sources in one flat folder, and runs Sphinx. Warnings are errors."""
    for old in (SOURCES, folder):
        if old.exists():
            shutil.rmtree(old)
    media = SOURCES / "extra" / "media"
    media.mkdir(parents=True)
    for path in (ROOT / "docs").glob("*"):
        if path.suffix == ".md":
            (SOURCES / path.name).write_text(_links(path.read_text(encoding="utf-8")), encoding="utf-8")
        elif path.is_file():
            shutil.copy(path, SOURCES)
    methods = {name: _rerun(name, method) for name, method in own_methods().items()}
    (SOURCES / "standings.md").write_text(standings_page(methods), encoding="utf-8")
    cards = write_task_pages(SOURCES, media, [*methods.values(), *by_released_rules()])
    (SOURCES / "gallery.md").write_text(gallery(media), encoding="utf-8")
    title, *rest = (SOURCES / "explain.md").read_text(encoding="utf-8").partition("\n")
    explained = [title, wrong_goals(methods, media), "## Your own evaluations", "".join(rest)]
    (SOURCES / "explain.md").write_text("\n\n".join(explained), encoding="utf-8")
    with (SOURCES / "shift-curves.md").open("a", encoding="utf-8") as page:
        page.write(shift_curves())
    command_line = [sys.executable, "-m", "typer", "magical_mj.cli.app", "utils", "docs", "--name", "magical-mj"]
    command_line += ["--title", "Command line", "--output", str(SOURCES / "command-line.md")]
    subprocess.run(command_line, check=True, stdout=subprocess.DEVNULL)
    start = home(methods, cards, media)
    for path in PAGES.iterdir():
        if (ROOT / "docs" / path.name).exists():
            raise SystemExit(f"{path.name} is in docs/ and in {PAGES}: give one of them another name")
        if path.suffix == ".md":
            (SOURCES / path.name).write_text(
                PLACEHOLDER.sub(lambda found: _filled(found, start), path.read_text(encoding="utf-8")), encoding="utf-8"
            )
        else:
            shutil.copy(path, SOURCES)
    (SOURCES / "logo.svg").write_text(_logo(), encoding="utf-8")
    shutil.copytree(ROOT / "site" / "style", SOURCES / "style")
    shutil.copy(ROOT / "site" / "conf.py", SOURCES)
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", str(SOURCES), str(folder)]
    shutil.copy(ROOT / "docs" / "scene.png", media)
    subprocess.run([*command, "-d", str(SOURCES / ".doctrees")], check=True)
    _finish(folder)


def _rerun(name: str, method: Standing) -> Standing:
    """The method after its policies have played fresh scenes, if its entry holds them."""
    if not (policies := stored_policies(RESULTS / name)):
        return method
    found = rerun(method.entry, policies, first_seed=0)
    if any(one.decided for one in found.values()):
        raise SystemExit(f"results/{name}: its policies do not score as the entry says")
    return standing(method.entry, found)


def _finish(folder: Path) -> None:
    """Makes the pages accessible, and writes the service worker, the page for errors and the sitemap."""
    for path in folder.glob("*.html"):
        text = path.read_text(encoding="utf-8")
        for found, fixed in FIXES.items():
            text = text.replace(found, fixed)
        if path.name in MOVED:
            text = text.replace("</head>", f"{_redirect(folder, path.name)}</head>")
        path.write_text(text, encoding="utf-8")
    shutil.copy(ROOT / "site" / "offline" / "pages.js", folder / "worker.js")
    address = os.environ.get("SITE_URL", "").rstrip("/")
    base = f'<base href="{address}/">' if address else FIND_BASE
    (folder / "404.html").write_text(MISSING.format(base=base, logo=_logo()), encoding="utf-8")
    if address:
        pages = sorted(path.name for path in folder.glob("*.html") if path.name != "404.html")
        pages += ["play/", "play/choose.html", "play/inspect.html", "play/intents.html"]
        addresses = "\n".join(f"{address}/{name}" for name in pages)
        (folder / "sitemap.txt").write_text(f"{addresses}\n", encoding="utf-8")


def _redirect(folder: Path, page: str) -> str:
    """A script for the links to parts of the page that are elsewhere now.

    Raises:
        SystemExit: if they are not there.
    """
    for address in MOVED[page].values():
        name, _, place = address.partition("#")
        if place and f'id="{place}"' not in (folder / name).read_text(encoding="utf-8"):
            raise SystemExit(f"{page} has parts that moved to {address}, which does not exist")
    places = json.dumps(MOVED[page])
    return f"<script>{{ const to = {places}[location.hash.slice(1)]; if (to) location.replace(to); }}</script>"


def _filled(found: re.Match[str], start: str) -> str:
    """The content for a placeholder such as `<!-- README: Quickstart -->`."""
    kind, name = found.groups()
    if kind == "README":
        return _links(section((ROOT / "README.md").read_text(encoding="utf-8"), name))
    if kind == "home":
        return start
    if kind == "file":
        return _links((ROOT / name).read_text(encoding="utf-8"))
    rows = (
        f"| {number} | {' | '.join(part.name.lower() for part in action)} |" for number, action in enumerate(ACTIONS)
    )
    return "| Action | Fingers | Turn | Drive |\n| ---: | --- | --- | --- |\n" + "\n".join(rows)


def section(text: str, heading: str) -> str:
    """The text below a heading of the second level. For an empty heading, the text between the title and the first one.

    Raises:
        SystemExit: if the heading does not exist.
    """
    found = {part.partition("\n")[0]: part.partition("\n")[2] for part in f"\n{text}".split("\n## ")[1:]}
    found[""] = text.partition("\n")[2].partition("\n## ")[0]
    if heading not in found:
        raise SystemExit(f"README.md has no section {heading!r}, but a page of the site includes it")
    return found[heading].strip()


def _links(text: str) -> str:
    """Converts links between files of the repository to links between pages, or to the repository if it is known.

    Otherwise, links to files that are not pages become plain text. Addresses of the pages to play on become links.
    """

    def link(found: re.Match[str]) -> str:
        label, target, anchor = found.groups()
        name = target.removeprefix("../").removeprefix("docs/")
        if name in REPOSITORY_FILES:
            return f"[{label}]({REPOSITORY_FILES[name]})"
        if (ROOT / "docs" / name).is_file():
            return f"[{label}]({name}{anchor or ''})"
        return f"[{label}]({REPOSITORY}/tree/main/{target.removeprefix('../')})" if REPOSITORY else label

    text = PLAYED.sub(r'<a href="\1"><code>\1</code></a>', text)
    if REPOSITORY:
        text = text.replace("open a pull request", f"[open a pull request]({REPOSITORY}/pulls)")
    return LINK.sub(link, text)


def _logo() -> str:
    """The logo, a drawing of the robot, as SVG."""
    known: dict[str, Any] = drawing_style()
    paths = []
    for layer in known["robots"]["gripper"]:
        x, y = known["fingerRoots"].get(layer["part"], (0, 0))
        turn = {"left_finger": 22.5, "right_finger": -22.5}.get(layer["part"], 0)
        loops = " ".join("M" + " ".join(f"{number:.4f}" for number in loop) + "Z" for loop in layer["loops"])
        paths.append(f'<path fill="{layer["colour"]}" transform="translate({x} {y}) rotate({turn})" d="{loops}"/>')
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="-0.3 -0.4 0.6 0.63">'
        f'<g transform="scale(1 -1)">{"".join(paths)}</g></svg>'
    )


if __name__ == "__main__":
    write_docs(FOLDER)
