"""Looks at the page of `dca view --page` as a person does, in a real browser.

Arguments: the link, the folder for pictures. Reads words from standard input and answers each with a line: `see TEXT` waits for a text,
`gone TEXT` waits until it is gone, `press NAME` presses a button, `fill LABEL = VALUE` types into a field, `choose LABEL = OPTION` chooses
from a list, `open NAME` opens a folded part with the keyboard, `mark KEY MARK` waits until a
box of a picture has a mark, `lose WIRE` has a wire lose values on the page, `picture NAME` draws it at 390 and 1400 pixels, `again N` opens the page
in N further windows, and then looks at the first one again, `reload` opens it again, `errors` fails if the page had errors, `end` ends it.
"""

import sys

from playwright.sync_api import sync_playwright

LINK, FOLDER = sys.argv[1], sys.argv[2]
WITHIN = 20_000


def luminance(colour):
    """Source: WCAG 2.2, relative luminance."""
    def part(value):
        value /= 255
        return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4

    red, green, blue = (part(value) for value in colour)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


CONTRASTS = """() => {
  const numbers = (text) => text.match(/[\\d.]+/g).map(Number);
  const behind = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const colour = numbers(getComputedStyle(at).backgroundColor);
      if (colour.length === 3 || colour[3] === 1) return colour;
    }
    return [255, 255, 255];
  };
  // The texts of a box stand on its band or below it, and those on a plate on the plate.
  const grounds = (element) => {
    const parts = element instanceof SVGElement ? [...element.parentElement.children].filter((part) => part.matches(".box, .band")) : [];
    const plate = element.previousElementSibling;
    const own = plate?.matches?.(".plate") ? [plate] : parts;
    const fills = own.map((part) => numbers(getComputedStyle(part).fill));
    return fills.length ? fills : [behind(element)];
  };
  const ink = (element) => numbers(getComputedStyle(element)[element instanceof SVGElement ? "fill" : "color"]).slice(0, 3);
  return [...document.querySelectorAll("body *")]
    .filter((element) => element.checkVisibility() && !element.matches("title, option"))
    .filter((element) => [...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim()))
    .flatMap((element) => grounds(element).map((ground) => [element.textContent.slice(0, 40), ink(element), ground.slice(0, 3)]));
}"""


# No robot of a test loses values, so the page is told so.
LOSE = """(name) => {
  for (const wire of model.wires.values()) if (wire.name === name) Object.assign(wire, { lost: 12, lostASecond: 3 });
  draw();
}"""


def check_contrast(page):
    for text, ink, ground in page.evaluate(CONTRASTS):
        light, dark = sorted([luminance(ink), luminance(ground)], reverse=True)
        ratio = (light + 0.05) / (dark + 0.05)
        assert ratio >= 4.5, f"contrast {ratio:.1f} of {text!r}: {ink} on {ground}"


def picture(page, name):
    for scheme in ["light", "dark"]:
        page.emulate_media(color_scheme=scheme)
        for width in [390, 1400]:
            page.set_viewport_size({"width": width, "height": 900})
            wide = page.evaluate("document.documentElement.scrollWidth")
            assert wide <= width, f"{name} is {wide} wide in {width}"
            check_contrast(page)
            page.screenshot(path=f"{FOLDER}/{name}-{scheme}-{width}.png", full_page=True)


def open_again(page, count):
    """More windows than a browser has connections for one host: each is live when it is opened, and gives orders. A window takes the
    place of a random one, so further windows are opened until the first one has lost its place."""
    others = []
    while len(others) < count or (not page.evaluate("isDisplaced") and len(others) < 64):
        other = page.context.new_page()
        other.goto(LINK)
        other.get_by_text("running").first.wait_for(timeout=WITHIN)
        others.append(other)
    answer = others[0].evaluate("order('/answer', {}).then(() => byId('word').textContent)")
    assert "no longer open" in answer, answer
    page.get_by_text("other windows show this page").wait_for(timeout=WITHIN)
    page.get_by_text("other windows show this page").click()
    page.get_by_text("not live since").wait_for(state="hidden", timeout=WITHIN)
    for other in others:
        other.close()


def main():
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        page = browser.new_context().new_page()
        wrong = []
        page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("dialog", lambda _: wrong.append("a script within a text runs"))
        page.goto(LINK)
        for line in sys.stdin:
            order, _, text = line.strip().partition(" ")
            try:
                if order == "see":
                    page.get_by_text(text).locator("visible=true").first.wait_for(timeout=WITHIN)
                elif order == "gone":
                    page.get_by_text(text).first.wait_for(state="hidden", timeout=WITHIN)
                elif order == "press":
                    page.get_by_role("button", name=text, exact=True).first.click(timeout=WITHIN)
                elif order == "fill":
                    label, _, value = text.partition(" = ")
                    page.get_by_label(label, exact=True).fill(value, timeout=WITHIN)
                elif order == "choose":
                    label, _, option = text.partition(" = ")
                    page.get_by_role("combobox", name=label).select_option(label=option, timeout=WITHIN)
                elif order == "open":
                    summary = page.locator("summary", has_text=text).first
                    summary.focus(timeout=WITHIN)
                    page.keyboard.press("Enter")
                elif order == "mark":
                    key, _, word = text.rpartition(" ")
                    page.locator(f'g.unit.{word}[data-key="{key}"]').first.wait_for(state="attached", timeout=WITHIN)
                elif order == "lose":
                    page.evaluate(LOSE, text)
                elif order == "reload":
                    page.reload()
                elif order == "picture":
                    picture(page, text)
                elif order == "again":
                    open_again(page, int(text))
                elif order == "errors":
                    known = [error for error in wrong if "ERR_" not in error]
                    assert not known, known
                elif order == "end":
                    print("ok", flush=True)
                    break
                else:
                    raise ValueError(order)
                print("ok", flush=True)
            except Exception as error:
                print(f"failed: {line.strip()}: {error}".replace("\n", " "), flush=True)
        browser.close()


main()
