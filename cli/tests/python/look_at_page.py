"""Opens a report in headless Chromium, plays and scrubs it, and takes screenshots.

usage: look_at_page.py CHROMIUM REPORT.html BLIND.html FOLDER
In the second report the angle of joint 9 is no number in the end.
Ends with 1 and one line per finding if something is not as it should be.
"""

import pathlib
import sys

from playwright.sync_api import sync_playwright

findings = []


def expect(what, good):
    if not good:
        findings.append(what)


def painted(page, selector):
    """Colours in a canvas: a blank one has a single one."""
    return page.evaluate(
        """selector => {
            const c = document.querySelector(selector);
            const { data } = c.getContext("2d").getImageData(0, 0, c.width, c.height);
            return new Set(new Uint32Array(data.buffer)).size;
        }""",
        selector,
    )


def picture(page, selector):
    return page.evaluate("selector => document.querySelector(selector).toDataURL()", selector)


def look(browser, report, folder):
    page = browser.new_page(viewport={"width": 1400, "height": 1000})
    requests = []
    page.on("request", lambda r: requests.append(r.url))
    page.on("pageerror", lambda e: findings.append(f"the script failed: {e}"))
    page.on("console", lambda m: m.type == "error" and findings.append(f"console: {m.text}"))
    page.goto(report.as_uri())
    expect(f"expected one request, got {requests}", len(requests) == 1)
    for selector in ["#scene", "#timeline", "#times", "#panels canvas:nth-child(1)", "#panels canvas:nth-child(9)"]:
        expect(f"{selector} is blank", painted(page, selector) > 10)
    expect("expected nine panels", page.locator("#panels canvas").count() == 9)
    expect("the summary is empty", page.locator("#summary tr").count() >= 5)
    expect("no settings", page.locator("#settings details").count() >= 5)
    page.screenshot(path=folder / "page.png", full_page=True)

    time = lambda: float(page.locator("#scrub").input_value())
    before, still = time(), picture(page, "#scene")
    page.click("#play")
    expect("no pause while playing", page.locator("#play").text_content() == "Pause")
    page.wait_for_timeout(600)
    page.click("#play")
    played = time()
    expect(f"time did not pass: {before} to {played}", played > before)
    expect("the robot did not move", picture(page, "#scene") != still)
    page.wait_for_timeout(200)
    expect("time passes in spite of the pause", time() == played)

    # The keys work after any click.
    page.keyboard.press("ArrowRight")
    expect("no step by a key after a click on the button", time() > played)
    page.keyboard.press(" ")
    expect("the space bar does not play", page.locator("#play").text_content() == "Pause")
    page.keyboard.press(" ")
    for selector in ["#speed", "#scrub", "#settings summary", "#panels canvas:nth-child(1)", "#scene"]:
        page.locator(selector).first.click()
        page.keyboard.press("Escape")
        page.locator(selector).first.evaluate("e => e.focus()")
        before = time()
        page.keyboard.press("ArrowLeft")
        expect(f"no step of 0.02 s after a click on {selector}", abs(before - 0.02 - time()) < 0.002)
        page.keyboard.press(" ")
        expect(f"the space bar does not play after a click on {selector}", page.locator("#play").text_content() == "Pause")
        page.keyboard.press(" ")
    expect("a key changed the speed", page.locator("#speed").input_value() == "1")
    # What is reached by Tab keeps its own keys.
    page.locator("#play").focus()
    page.keyboard.press("Tab")
    page.keyboard.press("ArrowDown")
    expect("the speed cannot be chosen by keys", page.locator("#speed").input_value() != "1")
    page.locator("#speed").select_option("1")

    # A page without a place to draw, and back.
    drawn = picture(page, "#panels canvas:nth-child(1)")
    for name, value in [("display", "none"), ("width", "0")]:
        page.evaluate("([name, value]) => { document.querySelector('main').style[name] = value; }", [name, value])
        page.evaluate("() => dispatchEvent(new Event('resize'))")
        page.locator("#scrub").evaluate("e => { e.value = 0.5; e.dispatchEvent(new Event('input')); }")
        page.evaluate("name => { document.querySelector('main').style[name] = ''; }", name)
    page.wait_for_function("drawn => document.querySelector('#panels canvas').toDataURL() !== drawn", arg=drawn)
    expect("nothing is drawn after it was hidden", painted(page, "#panels canvas:nth-child(1)") > 10)

    middle = 1.0
    page.locator("#scrub").fill(str(middle))
    expect(f"scrubbed to {middle}, shown {page.locator('#clock').text_content()}",
           page.locator("#clock").text_content() == f"{middle:.3f} s")
    cursor = picture(page, "#panels canvas:nth-child(1)")
    page.screenshot(path=folder / "scrubbed.png")
    box = page.locator("#panels canvas").first.bounding_box()
    page.locator("#panels canvas").first.click(position={"x": box["width"] * 0.8, "y": box["height"] / 2})
    expect("a click on a panel does not move time", time() > middle)
    expect("the cursor of the panel did not move", picture(page, "#panels canvas:nth-child(1)") != cursor)
    page.locator("#scrub").fill(page.locator("#scrub").get_attribute("max"))
    page.screenshot(path=folder / "end.png")
    page.set_viewport_size({"width": 420, "height": 900})
    page.screenshot(path=folder / "narrow.png")


def look_at_blind(browser, report):
    page = browser.new_page()
    page.on("pageerror", lambda e: findings.append(f"the script failed: {e}"))
    page.goto(report.as_uri())
    page.locator("#scrub").fill(page.locator("#scrub").get_attribute("max"))
    readout = page.locator("#readout").text_content()
    expect(f"an angle that is not known is shown as {readout}", "pendulum_2     NaN deg" in readout)


def main():
    chromium, folder = sys.argv[1], pathlib.Path(sys.argv[4])
    report, blind = (pathlib.Path(path).resolve() for path in sys.argv[2:4])
    folder.mkdir(exist_ok=True)
    with sync_playwright() as p:
        # Containers offer neither the sandbox of the browser nor much shared memory.
        browser = p.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-dev-shm-usage"])
        look(browser, report, folder)
        look_at_blind(browser, blind)
        browser.close()
    print("\n".join(findings) or "as it should be")
    sys.exit(bool(findings))


main()
