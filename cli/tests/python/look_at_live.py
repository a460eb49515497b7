"""Opens the live page in headless Chromium, swings up by its buttons, and takes screenshots.

usage: look_at_live.py CHROMIUM URL TOKEN FOLDER COMMAND...
The system holds at the start; the command makes the angle of joint 9 no number. Ends with 1 and one line per finding if
something is not as it should be.
"""

import pathlib
import subprocess
import sys

from playwright.sync_api import sync_playwright

findings = []
# A swing-up in real-time pace takes minutes where browser and system share a busy machine; ms.
LONG = 600_000


def expect(what, good):
    if not good:
        findings.append(what)


def watch(page, wanted):
    """Waits until the state on the page has a text."""
    page.wait_for_function(
        "wanted => document.getElementById('summary').textContent.includes(wanted)", arg=wanted
    )


def look(browser, url, token, folder, blind):
    page = browser.new_page(viewport={"width": 1400, "height": 1000})
    page.set_default_timeout(LONG)
    asked = []
    page.on("dialog", lambda d: (asked.append(d.message), d.accept()))
    page.on("pageerror", lambda e: findings.append(f"the script failed: {e}"))
    page.on("console", lambda m: m.type == "error" and findings.append(f"console: {m.text}"))
    page.goto(f"{url}#token={token}")
    watch(page, "modehold")
    picture = lambda selector: page.evaluate("s => document.querySelector(s).toDataURL()", selector)
    still = picture("#scene")
    expect("expected nine panels", page.locator("#panels canvas").count() == 9)
    # Frames that come while there is no place to draw are none of the script's failures, see pageerror.
    for style in ["display", "none"], ["width", "0"]:
        page.evaluate("([name, value]) => { document.querySelector('main').style[name] = value; }", style)
        page.evaluate("() => new Promise(done => { let n = 10; (function next() { n-- ? requestAnimationFrame(next) : done(); })(); })")
        page.evaluate("name => { document.querySelector('main').style[name] = ''; }", style[0])
    page.click("#swing-up")
    watch(page, "modetrack")
    watch(page, "modebalance")
    expect("the robot did not move", picture("#scene") != still)
    expect(f"expected one question before the swing-up, got {asked}", len(asked) == 1)
    events = page.locator("#events").text_content()
    expect(f"no request among the events: {events}", "asked: swing-up" in events and "mode balance" in events)
    expect("no cycle times", page.locator("#percentiles tr").count() >= 2)
    # Bars and curves: a blank canvas has a single colour.
    for selector in ["#scene", "#timeline", "#times", "#panels canvas:nth-child(1)", "#panels canvas:nth-child(9)"]:
        colours = page.evaluate(
            """s => {
                const c = document.querySelector(s);
                const { data } = c.getContext("2d").getImageData(0, 0, c.width, c.height);
                return new Set(new Uint32Array(data.buffer)).size;
            }""",
            selector,
        )
        expect(f"{selector} is blank", colours > 10)
    page.screenshot(path=folder / "balance.png", full_page=True)
    page.click("#stop")
    watch(page, "modehold")
    expect(f"a stop asks first: {asked}", len(asked) == 1)

    reader = browser.new_page()
    reader.set_default_timeout(LONG)
    reader.goto(url)
    reader.wait_for_function("() => document.getElementById('summary').rows.length > 3")
    expect("buttons without a token", not reader.locator("#requests").is_visible())
    # A new page has the last seconds at once: the mode before the stop is still in its events.
    expect("no history", "mode balance" in reader.locator("#events").text_content())

    subprocess.run(blind, check=True, stdout=subprocess.DEVNULL)
    watch(page, "modefault")
    watch(page, "last linkunknown")
    # The newest sample of the motion may be a frame older than the state.
    page.wait_for_function("() => document.getElementById('readout').textContent.includes('pendulum_2     NaN deg')")
    page.screenshot(path=folder / "blind.png", full_page=True)


def main():
    chromium, url, token, folder, *blind = sys.argv[1:]
    with sync_playwright() as p:
        # Containers offer neither the sandbox of the browser nor much shared memory.
        browser = p.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-dev-shm-usage"])
        look(browser, url, token, pathlib.Path(folder), blind)
        browser.close()
    print("\n".join(findings) or "as it should be")
    sys.exit(bool(findings))


main()
