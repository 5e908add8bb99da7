"""The report in a real browser: at the width of a phone nothing is cut, in either language."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from minidual.show.report.page import build_report
from tests.support import report_samples as samples
from tests.support.browser import Browser, find_browser
from tests.support.report_samples import figures_once  # noqa: F401  (a fixture for every test here)

BROWSER = find_browser()
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no browser: apt-get install chromium")

CUT = """
[...document.querySelectorAll('main *, .banners *')].filter(element => {
    if (element.closest('svg')) return false;
    const beyond = element.getBoundingClientRect().right > innerWidth + 0.5;
    const inside = getComputedStyle(element).display !== 'inline' && element.clientWidth > 0
        && element.scrollWidth > element.clientWidth + 1;
    return beyond || inside;
}).map(element => element.tagName + ' ' + element.className + ' ' + element.textContent.slice(0, 40))
"""
"""Elements that stick out of the page, or whose content is wider than they are."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(BROWSER, tmp_path_factory.mktemp("browser"), size=(390, 844)) as opened:
        yield opened


def page(root: Path, language: str) -> str:
    """Build a report with banners, disturbances and a picture; return its address."""
    given = samples.make_run(root, samples.disturbed_trials(20))
    report = given.config.report.model_copy(update={"language": language})
    config = given.config.model_copy(update={"report": report})
    given = replace(given, config=config, waivers=(samples.WAIVER,))
    folder = root / "page"
    folder.mkdir()
    build_report(given, folder)
    return (folder / "report.html").as_uri()


def opened(browser: Browser, address: str, width: int) -> None:
    browser.call(
        "Emulation.setDeviceMetricsOverride",
        width=width,
        height=844,
        deviceScaleFactor=1,
        mobile=False,
    )
    browser.go(address)
    browser.evaluate("document.querySelectorAll('details').forEach(one => one.open = true)")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_nothing_is_cut_on_a_phone_or_a_laptop(
    browser: Browser,
    tmp_path: Path,
    language: str,
) -> None:
    address = page(tmp_path, language)
    for width in (390, 1280):
        opened(browser, address, width)
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        assert browser.evaluate(CUT) == []
    assert browser.evaluate("document.querySelectorAll('.headlines li').length") in range(1, 6)


def test_a_table_that_is_too_wide_is_noticed(browser: Browser, tmp_path: Path) -> None:
    opened(browser, page(tmp_path, "en"), 390)
    browser.evaluate("document.querySelector('.comparison').style.minWidth = '760px'")
    assert any("TABLE comparison" in element for element in browser.evaluate(CUT))


def test_the_first_screen_shows_the_sentences_and_its_grey_print_keeps_contrast(
    browser: Browser,
    tmp_path: Path,
) -> None:
    opened(browser, page(tmp_path, "en"), 1280)
    top = browser.evaluate("document.querySelector('.headlines').getBoundingClientRect().top")
    assert 0 < top < 844
    grey = browser.picture().mean(axis=2)
    assert np.percentile(grey, 99) - grey.min() > 150
