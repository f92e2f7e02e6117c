"""The report in a real browser: what a user does with it, and that it loads nothing else."""

import json
import math
import sys

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.support.select import Select
from selenium.webdriver.support.wait import WebDriverWait

from map_racing.bags.writer import BagWriter
from map_racing.cli import main
from map_racing.control.controller import build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.settings import settings_text
from map_racing.track.files.load import load_raceline
from map_racing.track.files.waypoints import waypoint_rows
from map_racing.vehicle.parameters import load_vehicle

WIDTH, HEIGHT = 1280, 720
# A name that would be markup.
EVIL = "<img src=x onerror=alert(1)>&amp;"


def drive(path, line, scale):
    """Three and a half laps at a scale of the raceline's speeds, a little wider in each lap."""
    parameters = load_controller_parameters("map")
    controller = build_controller(parameters, load_vehicle("nuc4"), line)
    with BagWriter(path) as bag:
        bag.waypoints(1.0, waypoint_rows(line))
        bag.text(1.0, settings_text(controller, name="map"))
        t, s = 2.0, -3.0
        while s < 3.5 * line.length:
            here, v = line.pose(s), scale * line.speed_at(s)
            d = 0.01 * (1.0 + s / line.length) * math.sin(0.9 * s)
            v *= 1.0 - 0.02 * math.sin(0.4 * s) ** 2
            x, y = line.to_cartesian(s, d)
            bag.odometry(t, float(x), float(y), here.psi, v, 0.0, v * here.kappa)
            bag.drive(t, math.atan(0.31 * here.kappa), scale * line.speed_at(s))
            t, s = t + 0.025, s + 0.025 * v


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A report on two runs."""
    folder = tmp_path_factory.mktemp("report")
    line = load_raceline("reference")
    bags = [folder / f"{EVIL}.bag", folder / "other.bag"]
    for bag, scale in zip(bags, (0.65, 0.7)):
        drive(bag, line, scale)
    output = folder / "report.html"
    with pytest.MonkeyPatch.context() as patch:
        # It needs its own extra alone; what the others bring is here, too.
        for name in ("distributed", "dask", "zstandard", "osqp", "vehiclemodels"):
            patch.setitem(sys.modules, name, None)
        assert main(["report", *map(str, bags), "--output", str(output)]) == 0
    return output


@pytest.fixture(scope="module")
def browser():
    options = webdriver.ChromeOptions()
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options, Service("/usr/bin/chromedriver"))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def opened(browser, page):
    """The drawn page at 1280 x 720; its requests and errors are checked at the end."""
    size = {"width": WIDTH, "height": HEIGHT, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get(page.as_uri())
    until_drawn(browser)
    return browser


def until_drawn(browser):
    WebDriverWait(browser, 60).until(
        lambda b: (
            b.find_elements(By.CSS_SELECTOR, "#charts .main-svg")
            and b.find_elements(By.CSS_SELECTOR, "#map .main-svg")
        )
    )


def requests(browser):
    """Addresses other than the file itself that the page requested."""
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    sent = [m for m in messages if m["method"] == "Network.requestWillBeSent"]
    addresses = {m["params"]["request"]["url"] for m in sent}
    return {a for a in addresses if not a.startswith(("data:", "blob:", "file:"))} | {
        a for a in addresses if a.startswith("file:") and not a.endswith("report.html")
    }


def readout(browser):
    return browser.find_element(By.ID, "readout").text


def charts(browser):
    return browser.find_element(By.CSS_SELECTOR, "#charts .nsewdrag")


def boxes(browser, selector):
    rects = [element.rect for element in browser.find_elements(By.CSS_SELECTOR, selector)]
    return [(r["x"], r["y"], r["x"] + r["width"], r["y"] + r["height"]) for r in rects]


def overlap(a, b, allowed=2):
    return all(
        min(a[i + 2], b[i + 2]) - max(a[i], b[i]) > allowed  # along x, along y
        for i in (0, 1)
    )


def titles_are_apart(browser):
    """Whether no title or legend of the charts covers another one or a curve."""
    texts, areas = (boxes(browser, f"#charts {kind}") for kind in (".annotation-text", ".nsewdrag"))
    assert len(texts) == 9 and len(areas) == 5
    others = [texts[:i] + areas for i in range(len(texts))]
    return not any(overlap(a, b) for a, rest in zip(texts, others) for b in rest)


def move(browser, element, share):
    """Move the mouse to a share of an element's width."""
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
    across = int((share - 0.5) * element.rect["width"])
    ActionChains(browser, 50).move_to_element_with_offset(element, across, 0).perform()


def x_range(browser):
    return browser.execute_script("return document.getElementById('charts').layout.xaxis.range")


def test_the_first_screen_names_the_three_places_that_cost_most(opened):
    places = opened.find_elements(By.CSS_SELECTOR, ".places:not([hidden]) li")
    assert len(places) == 3
    for place in places:
        assert place.text.startswith("s = ") and " m/s" in place.text
        assert "left: " in place.text or "right: " in place.text
        box = place.rect
        assert box["y"] + box["height"] <= HEIGHT and box["x"] + box["width"] <= WIDTH
    numbers = opened.find_elements(By.CSS_SELECTOR, "#map .annotation-text")
    assert [number.text for number in numbers] == ["1", "2", "3"]
    assert all(number.rect["y"] < HEIGHT for number in numbers)
    assert "of the grip used" in places[0].text
    assert titles_are_apart(opened)
    # Nothing is wider than the screen.
    wide = "return document.documentElement.scrollWidth"
    assert opened.execute_script(wide) <= WIDTH


def test_one_cursor_in_charts_map_and_readout(opened):
    places = []
    dot = opened.find_element(By.CSS_SELECTOR, "#map .dot")
    for share in (0.25, 0.75):
        move(opened, charts(opened), share)
        cursor = opened.find_element(By.CSS_SELECTOR, "#charts .cursor").rect
        places.append((cursor["x"], dot.rect["x"], dot.rect["y"], readout(opened)))
    assert places[1][0] - places[0][0] == pytest.approx(charts(opened).rect["width"] / 2, abs=4)
    assert places[0][1:3] != places[1][1:3]
    s = [float(place[3].split()[2]) for place in places]
    assert s[0] / 36.54 == pytest.approx(0.25, abs=0.02) and s[1] / 36.54 == pytest.approx(
        0.75, abs=0.02
    )
    # The cursor spans all five charts, and the mouse on the map moves it, too.
    assert cursor["height"] > 0.9 * opened.find_element(By.ID, "charts").rect["height"]
    before = readout(opened)
    move(opened, opened.find_element(By.ID, "map"), 0.2)
    assert readout(opened) != before


def test_zoom_by_dragging_and_by_a_place(opened):
    whole = x_range(opened)
    drag = charts(opened)
    opened.execute_script("arguments[0].scrollIntoView({block: 'center'})", drag)
    quarter = int(drag.rect["width"] / 4)
    ActionChains(opened, 100).move_to_element_with_offset(
        drag, -quarter, 0
    ).click_and_hold().move_by_offset(2 * quarter, 0).release().perform()
    low, high = x_range(opened)
    length = whole[1]
    assert low / length == pytest.approx(0.25, abs=0.03)
    assert high / length == pytest.approx(0.75, abs=0.03)
    # The charts share one axis, so all have zoomed; the button zooms out.
    axes = opened.execute_script(
        "return Object.keys(document.getElementById('charts')._fullLayout)"
        ".filter((k) => /^xaxis/.test(k))"
    )
    assert axes == ["xaxis"]
    opened.find_element(By.ID, "whole").click()
    assert x_range(opened) == whole
    place = opened.find_element(By.CSS_SELECTOR, ".places:not([hidden]) .zoom")
    place.click()
    begin, end = (float(place.get_attribute(f"data-{name}")) for name in ("begin", "end"))
    low, high = x_range(opened)
    assert 0.0 <= low <= begin and end <= high < begin + 0.6 * length


def test_the_map_has_another_color(opened):
    def drawn():
        marks = opened.find_elements(By.CSS_SELECTOR, "#map .point")
        return [mark.get_attribute("style") for mark in marks[::20]]

    before, scale = drawn(), opened.find_element(By.ID, "scale").text
    color = Select(opened.find_element(By.ID, "color"))
    names = [option.text for option in color.options]
    assert {"speed", "time lost per meter", "grip used", "steering beyond the table"} <= set(names)
    color.select_by_visible_text("grip used")
    assert drawn() != before and opened.find_element(By.ID, "scale").text != scale
    assert "%" in opened.find_element(By.ID, "scale").text


def test_another_lap_and_another_reference(opened):
    reference = Select(opened.find_element(By.ID, "place-reference"))
    before = opened.find_element(By.CSS_SELECTOR, ".places:not([hidden])").text
    reference.select_by_visible_text("the ideal lap")
    assert opened.find_element(By.CSS_SELECTOR, ".places:not([hidden])").text != before
    run = Select(opened.find_element(By.ID, "place-run"))
    run.select_by_visible_text("other")
    shown = opened.find_element(By.CSS_SELECTOR, ".places:not([hidden])")
    assert shown.get_attribute("data-run") == "1"
    chips = opened.find_elements(By.CSS_SELECTOR, ".lap[data-lap]")
    chips[0].click()
    assert "shown-a" in chips[0].get_attribute("class")
    opened.find_element(By.ID, "all-laps").click()
    laps = "return document.getElementById('charts').data.filter((t) => t.name === 'all laps')"
    assert len(opened.execute_script(laps)) == 5


def test_names_are_text(opened):
    assert opened.title.startswith(EVIL)
    assert opened.find_element(By.TAG_NAME, "h1").text.startswith(EVIL)
    assert opened.find_elements(By.TAG_NAME, "img") == []


def test_laps_of_a_recording_with_a_long_name(opened):
    opened.execute_script(
        "document.querySelectorAll('.laps span').forEach("
        "(span) => { span.textContent = 'map_racing_2026-11-29-23-03-56_second_heat'; })"
    )
    name = opened.find_element(By.CSS_SELECTOR, ".laps span")
    button = opened.find_element(By.CSS_SELECTOR, ".laps button")
    assert name.rect["height"] <= 1.5 * 16 and button.rect["height"] <= 2.0 * 16
    opened.refresh()
    until_drawn(opened)


def test_on_a_phone(opened):
    size = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    opened.refresh()
    WebDriverWait(opened, 60).until(lambda b: b.find_elements(By.CSS_SELECTOR, "#charts .main-svg"))
    assert opened.execute_script("return document.documentElement.scrollWidth") <= 390
    first = opened.find_element(By.CSS_SELECTOR, ".places:not([hidden]) li")
    assert first.rect["y"] + first.rect["height"] <= 844
    assert titles_are_apart(opened)
    assert opened.find_element(By.ID, "map").rect["width"] > 0.9 * 390


def test_on_paper(opened):
    """Nothing is wider than A4 between its margins."""
    opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    size = {"width": 703, "height": 1032, "deviceScaleFactor": 1, "mobile": False}
    opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    opened.refresh()
    until_drawn(opened)
    opened.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    assert opened.execute_script("return document.documentElement.scrollWidth") <= 703
    opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_the_next_heat_and_the_car(opened):
    text = opened.find_element(By.ID, "next-heat").text
    assert "s predicted with these scales" in text and "first left" in text
    assert "delay of the steering" in opened.find_element(By.ID, "car").text


def test_nothing_was_asked_from_a_network_and_no_error_was_logged(opened):
    assert requests(opened) == set()
    assert [entry["message"] for entry in opened.get_log("browser")] == []
