"""The documentation site: built strictly, complete, without a network, and right in a browser, on a phone as well."""

import inspect
import subprocess
import sys
import zlib
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import browsing
import pytest
from documentation import DOCS, program
from public import NAMESPACES

import spherejax as sj
from spherejax.namespaces import MOVED

PHONE, DESKTOP = (390, 844), (1300, 900)
needs_browser = pytest.mark.skipif(bool(browsing.missing()), reason=browsing.missing() or "-")


def build(source: Path, out: Path) -> subprocess.CompletedProcess:
    """As the README says, to another folder."""
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-n", "-E", "-b", "html", source, out]
    return subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=600, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("site")
    built = build(DOCS, out)
    assert built.returncode == 0, built.stderr
    return out


def test_a_broken_link_and_a_broken_reference_fail_the_build(tmp_path):
    (tmp_path / "conf.py").write_text((DOCS / "conf.py").read_text().replace("HERE / ", f"Path({str(DOCS)!r}) / "))
    (tmp_path / "_static").mkdir()
    (tmp_path / "index.md").write_text("# Index\n\n[](no_such_page.md) and {py:class}`spherejax.NoSuchName`\n")
    built = build(tmp_path, tmp_path / "out")
    assert built.returncode != 0
    assert "no_such_page.md" in built.stderr
    assert "NoSuchName" in built.stderr


def test_a_wrong_equation_or_table_fails_the_build():
    from sphinx.errors import SphinxError

    mathml, tables = program("extensions/mathml"), program("extensions/result_tables")
    for wrong in (r"\frac{1}", r"\nosuchcommand x", r"\left( x"):
        with pytest.raises(SphinxError, match="equation"):
            mathml.mathml(wrong, as_block=True)
    path = tables.RESULTS / "four_bar_runs.csv"
    _, rows = tables.read(path)
    with pytest.raises(SphinxError, match="no row with"):
        tables.chosen(rows, "rtol=7", path)


DOCSTRING = """Force |e| of a_law*.

    f = k |e|**2

Attributes:
    stiffness: k [N/m], see `Dry` and `mu_k`,
        continued.
    a, b: two at once.

Returns:
    What it is.

Limits: none at e = 0.
"""

RST = r"""Force \|e\| of a\_law\*.

.. code-block:: none

        f = k |e|**2

:Attributes:

    * ``stiffness`` -- k [N/m], see \ :py:obj:`Dry <spherejax.Dry>`\  and \ ``mu_k``\ , continued.
    * ``a``, ``b`` -- two at once.

:returns: What it is.

**Limits.** none at e = 0.
"""


def test_docstrings_become_restructured_text():
    written = program("extensions/docstrings").rst(DOCSTRING.splitlines())
    assert "\n".join(written).strip() == RST.strip()


# What is there ----------------------------------------------------------------------------------------------------


def inventory(site: Path) -> set[str]:
    """Names that can be linked to, as Sphinx lists them for other projects."""
    head, _, packed = (site / "objects.inv").read_bytes().partition(b"zlib.\n")
    assert b"Project: spherejax" in head
    return {line.split()[0] for line in zlib.decompress(packed).decode().splitlines()}


def test_every_public_name_is_in_the_reference(site):
    modules = {name for name in sj.__all__ if inspect.ismodule(getattr(sj, name))}
    assert modules == {"gallery", "plot", "priors", "runtime", *NAMESPACES}
    names = {f"spherejax.{name}" for name in sj.__all__ if name not in modules}
    names |= {f"spherejax.{space}.{name}" for name, space in MOVED.items()}
    for module in (sj.gallery, sj.plot, sj.priors):
        names |= {f"{module.__name__}.{name}" for name in module.__all__}
    names |= {"spherejax.runtime.configure", "spherejax.Trajectory.position", "spherejax.Threlfall.secant"}
    missing = names - inventory(site)
    assert not missing, f"add {sorted(missing)} to a page of docs/api, or their module to one with public-names"


class Page(HTMLParser):
    """Anchors, links and pictures of a page, and what it loads."""

    def __init__(self, path: Path):
        super().__init__()
        self.path, self.anchors, self.links, self.images, self.loads = path, set(), [], [], []
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.anchors |= {found[key] for key in ("id", "name") if key in found}
        if tag == "a" and "href" in found:
            self.links.append(found["href"])
        if tag == "img":
            self.images.append((found.get("src", ""), found.get("alt", "")))
        if tag in ("script", "img", "iframe") and "src" in found:
            self.loads.append(found["src"])
        if tag == "link" and found.get("rel") in ("stylesheet", "preload", "icon"):
            self.loads.append(found["href"])


@pytest.fixture(scope="module")
def pages(site):
    return {path: Page(path) for path in sorted(site.rglob("*.html")) if "_static" not in path.parts}


def test_links_lead_somewhere(pages):
    broken = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                assert parts.scheme in ("https", "mailto"), link
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            anchors = pages[target].anchors | {"", "top"} if target in pages else {""}
            if not target.exists() or unquote(parts.fragment) not in anchors:
                broken.append(f"{path.name}: {link}")
    assert not broken


def test_pictures_are_there_and_described(pages):
    images = [(page.path, *image) for page in pages.values() for image in page.images]
    assert len(images) >= len(sj.gallery.__all__) + 8
    assert not [image for path, *image in images if not (path.parent / unquote(image[0])).is_file()]
    assert not [place for _, place, text in images if "_static" not in place and len(text) < 10]


def test_the_site_needs_no_network(site, pages):
    assert not [load for page in pages.values() for load in page.loads if urlsplit(load).netloc]
    sheets = "".join(sheet.read_text() for sheet in (site / "_static").rglob("*.css"))
    assert "url(http" not in sheets.replace('"', "").replace("'", "")
    assert "url(//" not in sheets.replace('"', "").replace("'", "")


# In a browser -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def opened(site):
    with browsing.served(site) as address, browsing.chromium() as driver:
        yield driver, address


def complaints(driver) -> list[str]:
    """Warnings and errors on the console since the last call."""
    return [entry["message"] for entry in driver.get_log("browser") if entry["level"] in ("WARNING", "SEVERE")]


WRONG = """<!doctype html><meta name="viewport" content="width=device-width, initial-scale=1">
<article style="margin: 0">
<div style="width: 900px; height: 9px; background: red">a</div><img src="none.png" alt="not there"><math></math>
<div style="overflow-x: auto"><div style="width: 900px; height: 9px"></div></div></article>
<script>console.error("wrong")</script>
"""


@needs_browser
def test_the_checks_see_what_is_wrong(tmp_path):
    (tmp_path / "index.html").write_text(WRONG)
    with browsing.served(tmp_path) as address, browsing.chromium() as driver:
        browsing.set_size(driver, *PHONE)
        driver.get(f"{address}/index.html")
        wide = driver.execute_script(browsing.TOO_WIDE)
        assert sum("background: red" in node and node.startswith("<div") for node in wide) == 1
        assert sum("overflow-x" in node and node.startswith("<div") for node in wide) == 0
        assert len(driver.execute_script(browsing.NOT_SHOWN)) == 2
        assert sum("wrong" in message or "none.png" in message for message in complaints(driver)) == 2


@needs_browser
def test_every_page_fits_a_phone_and_shows_what_it_has(opened, site, pages):
    driver, address = opened
    browsing.set_size(driver, *PHONE)
    problems = {}
    for path in pages:
        name = path.relative_to(site).as_posix()
        driver.get(f"{address}/{name}")
        found = [
            *(f"too wide: {node}" for node in driver.execute_script(browsing.TOO_WIDE)),
            *(f"not shown: {node}" for node in driver.execute_script(browsing.NOT_SHOWN)),
            *complaints(driver),
        ]
        if found:
            problems[name] = found
    assert not problems


@needs_browser
def test_navigation_leads_through_the_site(opened):
    from selenium.webdriver.common.by import By

    def shows(title):
        browsing.wait_until(driver, lambda d: d.find_element(By.TAG_NAME, "h1").text.startswith(title))

    driver, address = opened
    browsing.set_size(driver, *DESKTOP)
    driver.get(f"{address}/index.html")
    for link, title in (("Concepts", "Concepts"), ("The lubricated joint", "The lubricated joint")):
        browsing.click(driver, By.LINK_TEXT, link)
        shows(title)
    browsing.click(driver, By.PARTIAL_LINK_TEXT, "sj.Guembel")
    browsing.wait_until(driver, lambda d: d.current_url.endswith("api/film.html#spherejax.Guembel"))

    browsing.set_size(driver, *PHONE)
    driver.get(f"{address}/howto/sweep.html")
    browsing.click(driver, By.CSS_SELECTOR, "button.primary-toggle")
    browsing.click(driver, By.LINK_TEXT, "Gallery")
    shows("Gallery")
    assert not complaints(driver)


@needs_browser
@pytest.mark.parametrize(
    ("query", "page"),
    [("viscosity", "concepts/film.html"), ("LankaraniNikravesh", "api/normal_laws.html"), ("csv", "howto/fit.html")],
)
def test_search_finds(opened, query, page):
    from selenium.webdriver.common.by import By

    driver, address = opened
    browsing.set_size(driver, *DESKTOP)
    driver.get(f"{address}/index.html")
    browsing.click(driver, By.CSS_SELECTOR, "button.search-button__button")
    field = browsing.visible(driver, By.CSS_SELECTOR, "input[name=q]")
    field.send_keys(query)
    field.submit()
    browsing.wait_until(
        driver,
        lambda d: any(
            page in (a.get_attribute("href") or "") for a in d.find_elements(By.CSS_SELECTOR, "#search-results a")
        ),
    )
    assert not complaints(driver)
