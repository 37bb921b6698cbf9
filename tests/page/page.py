"""Looks at the live page in a headless browser.

page.py PROGRAM SHOTS: makes runs with PROGRAM, visits their pages, checks each one on desktop and phone, light and dark, and
leaves screenshots in SHOTS. Exit status 0 if everything is as it should be.
"""

import contextlib
import json
import pathlib
import shutil
import socket
import subprocess
import sys
import tempfile
import time

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect, sync_playwright

LIMIT_MS = 60_000
SCREENS = {
    "desktop": {"width": 1280, "height": 900},
    "phone": {"width": 390, "height": 844},
}
# Smallest letters that are shown, pixels.
LEAST_TEXT = 12
SMALL_TEXT = """least => [...document.querySelectorAll('main *')]
    .filter(e => [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim()) && e.getClientRects().length)
    .filter(e => !(e instanceof SVGElement) && parseFloat(getComputedStyle(e).fontSize) < least)
    .map(e => e.outerHTML.slice(0, 120))"""
EVIL = "<img src=x onerror=window.pwned=1>"

faults = []


def check(what, ok, found=""):
    if not ok:
        faults.append(f"{what}: {found}")
        print(f"FAULT {what}: {found}")


def train(program, *args, check_status=True):
    done = subprocess.run([program, "train", *args], capture_output=True, text=True, timeout=300)
    if check_status and done.returncode != 0:
        raise SystemExit(f"train {args}: {done.stderr}")
    return done


@contextlib.contextmanager
def watching(program, folder):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = subprocess.Popen([program, "watch", folder, "--port", str(port)], stdout=subprocess.PIPE, text=True)
    try:
        assert "http://" in server.stdout.readline()
        yield f"http://127.0.0.1:{port}"
    finally:
        server.kill()
        server.wait()


class Visitor:
    """A browser with one screen and one colour scheme."""

    def __init__(self, browser, screen, scheme, shots):
        self.name = f"{screen}-{scheme}"
        self.shots = shots
        self.context = browser.new_context(viewport=SCREENS[screen], color_scheme=scheme, reduced_motion="reduce")
        self.page = self.context.new_page()
        self.page.set_default_timeout(LIMIT_MS)
        self.said = []
        self.page.on("console", lambda message: self.said.append(message.text) if message.type in ("error", "warning") else None)
        self.page.on("pageerror", lambda error: self.said.append(str(error)))

    def visit(self, name, url, ready):
        what = f"{name} on {self.name}"
        self.said.clear()
        self.page.goto(url)
        expect(self.page.locator(ready).first).to_be_visible(timeout=LIMIT_MS)
        self.page.wait_for_timeout(300)
        self.page.screenshot(path=self.shots / f"{name}-{self.name}.png", full_page=True)
        self.judge(what)

    def judge(self, what):
        for violation in Axe().run(self.page).response["violations"]:
            if violation["impact"] in ("serious", "critical"):
                places = [node["target"] for node in violation["nodes"]][:3]
                check(what, False, f"axe: {violation['id']} {places}")
        check(what, not self.said, self.said)
        sides = self.page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
        check(what, sides[0] <= sides[1], f"wider than its screen: {sides}")
        small = self.page.evaluate(SMALL_TEXT, LEAST_TEXT)
        check(what, not small, f"letters below {LEAST_TEXT} px: {small[:3]}")
        check(what, self.page.evaluate("window.pwned") is None, "a script of a run was executed")


    def letters(self, name):
        """Letters of pictures are drawn in the picture's own measure."""
        sizes = self.page.evaluate("[...document.querySelectorAll('svg text')].map(e => parseFloat(e.getAttribute('font-size')) * e.getScreenCTM().a)")
        check(f"{name} on {self.name}", sizes and min(sizes) >= LEAST_TEXT, f"letters of {min(sizes, default=0):.1f} px in a picture")


def hostile(folder, like):
    """A copy of the run `like` whose names, logs and settings are scripts."""
    run = folder / EVIL.replace("/", "") / "seed-0"
    shutil.copytree(like, run, symlinks=True)
    (run / "logs" / "learner.log").write_text(f"{EVIL}\n</pre>{EVIL}\n\x1b[31m{EVIL}\n")
    (run / "logs" / f"{EVIL.replace('/', '')}.log").write_text(f"{EVIL}\n")
    (run / "command.txt").write_text(f"{EVIL}\n")
    (run / "build.json").write_text(f'{{"version": "{EVIL}", "commit": "{EVIL}"}}')
    config = run / "config.toml"
    config.write_text(config.read_text() + f"\n# {EVIL}\n")
    timeline = run / "timeline.jsonl"
    head, *moments = timeline.read_text().splitlines()
    timeline.write_text("\n".join([head.replace('"NE"', f'"{EVIL}"'), *moments, EVIL, '{"kind": 7, "path": "x"}', '{"torn']))
    with open(run / "metrics.jsonl", "a") as metrics:
        metrics.write("x" * 200_000 + f"\n{EVIL}\n")


def strange(folder, like):
    """Copies of the run `like` whose numbers are beyond all measure, or whose name is as long as can be: where each is."""
    runs = {"numbers": folder / "numbers", "long": folder / ("n" * 250)}
    for run in runs.values():
        shutil.copytree(like, run, symlinks=True)
    run = runs["numbers"]
    (run / "result.json").unlink()
    (run / "metrics.jsonl").write_text("".join(json.dumps({"time/episodes": sign * 1e308, "time/total_timesteps": -5, "time/time_elapsed": 1e300,
        "train/n_updates": 1, "time/fps": -1e308, "train/loss": 1e308}) + "\n" for sign in (-1, 1) * 500))
    heading = (run / "evals.csv").read_text().splitlines()[0]
    (run / "evals.csv").write_text(f"{heading}\n" + "".join(f"{at},{10 ** at},1,1,1e308,1,1\n" for at in range(300)))
    head, *moments = (run / "timeline.jsonl").read_text().splitlines()
    head = json.loads(head)
    # A page that believed these would ask for terabytes.
    head["squares"], head["dims"] = 1_000_000, 1e9
    (run / "timeline.jsonl").write_text("\n".join([json.dumps(head), *moments, ""]))
    return runs


def crowd(folder, like, runs=100_000):
    """A folder of ever so many copies of the run `like`, most of which have no more than their settings and a torn result."""
    settings, result = folder / "settings", folder / "result"
    folder.mkdir()
    for number in range(runs):
        arm = folder / f"arm-{number // 1000}"
        if number % 1000 == 0:
            # File systems limit how many names a file can have.
            arm.mkdir()
            settings, result = arm / "config.toml", arm / "torn"
            settings.write_bytes((like / "config.toml").read_bytes())
            result.write_text('{"algo": "dq')
        run = arm / f"seed-{number}"
        run.mkdir()
        (run / "config.toml").hardlink_to(settings)
        (run / "result.json").hardlink_to(result)


def use(page, name):
    """What hands and keys do on the page of a run."""
    slider = page.get_by_role("slider", name="Moment of the run")
    before = slider.input_value()
    slider.focus()
    page.keyboard.press("Home")
    check(name, slider.input_value() == "0" and before != "0", f"the slider is at {slider.input_value()}")
    expect(page.get_by_role("button", name="Latest")).to_be_enabled()
    page.get_by_role("button", name="Latest").click()
    check(name, slider.input_value() == before, "the latest moment is not shown again")
    page.get_by_role("button", name="Step after").click()
    expect(page.get_by_label("Mentor step", exact=True).get_by_role("heading")).to_contain_text("1 of")
    page.get_by_role("radio", name="Values").check()
    page.get_by_role("radio", name="Mentor's time line").check()
    expect(page.get_by_role("img", name="Bridge map")).to_be_visible()
    page.get_by_role("radio", name="minutes").check()
    page.get_by_text("Settings of this run").click()
    expect(page.get_by_label("config.toml")).to_contain_text("[run]")


def look_closer(visitor, url, name):
    """A part of a chart that was enlarged stays so while the run goes on, and a page that nobody sees gives its stream back."""
    page, facts = visitor.page, visitor.page.locator(".facts")
    page.goto(url)
    chart = page.get_by_role("img", name="Learning curve")
    expect(chart.locator(".u-over")).to_be_visible(timeout=LIMIT_MS)
    box = chart.locator(".u-over").bounding_box()
    page.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 40, steps=5)
    page.mouse.up()
    page.mouse.move(0, 0)
    page.wait_for_timeout(300)
    picture, before = (chart.locator("canvas").evaluate("canvas => canvas.toDataURL()"), facts.inner_text())
    expect(facts).not_to_have_text(before, timeout=LIMIT_MS)
    check(name, chart.locator("canvas").evaluate("canvas => canvas.toDataURL()") == picture, "an enlarged part of a chart does not stay")
    hide = "hidden => { Object.defineProperty(document, 'hidden', { value: hidden, configurable: true }); document.dispatchEvent(new Event('visibilitychange')) }"
    with page.expect_request(lambda request: "/state" in request.url, timeout=LIMIT_MS):
        page.evaluate(hide, True)
    with page.expect_request(lambda request: "/events" in request.url, timeout=LIMIT_MS):
        page.evaluate(hide, False)


def main():
    program, shots = sys.argv[1], pathlib.Path(sys.argv[2])
    shutil.rmtree(shots, ignore_errors=True)
    shots.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as place, contextlib.ExitStack() as stack:
        place = pathlib.Path(place)
        runs = place / "runs"
        done, plain = runs / "maze-ha-diiqn-seed0", runs / "maze-dqn-seed0"
        train(program, "maze-small", "--algo", "ha-diiqn", "--env-steps", "8000", "--quiet", "--out", done)
        train(program, "maze-small", "--algo", "dqn", "--env-steps", "8000", "--quiet", "--out", plain)
        train(program, "maze-small", "--mode", "free", "--actors", "2", "--env-steps", "4000", "--quiet", "--out", runs / "free")
        often = ["--set", "env.hazard.kind=panic", "--set", "env.hazard.after=600", "--set", "supervise.restarts=30"]
        train(program, "maze-small", "--mode", "free", "--actors", "2", "--env-steps", "6000", "--quiet", "--out", runs / "restarts", *often)
        train(program, "maze-small", "--env-steps", "100", "--quiet", "--out", runs / "short")
        hazard = ["--set", "env.hazard.kind=panic", "--set", "env.hazard.after=2000", "--set", "supervise.restarts=0"]
        failed = train(program, "maze-small", "--quiet", "--out", runs / "failing", *hazard, check_status=False)
        check("failing", failed.returncode != 0, "the run did not fail")
        sweep = place / "sweep"
        subprocess.run([program, "sweep", "maze-small", "--algos", "dqn,ha-diiqn", "--seeds", "0..3", "--env-steps", "4000", "--quiet",
                        "--out", sweep], check=True, capture_output=True, timeout=300)
        subprocess.run([program, "report", sweep], check=True, capture_output=True, timeout=300)
        report = (sweep / "report" / "report.html").as_uri()
        evil = place / "evil"
        hostile(evil, done)
        (evil / "out").symlink_to("/etc")
        odd = strange(place / "odd", done)
        (place / "empty").mkdir()
        live = place / "live"
        trainer = subprocess.Popen([program, "train", "maze30", "--algo", "ha-diiqn", "--quiet", "--out", live, "--env-steps", "100000000", "--episodes",
                                    "1000000"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        stack.callback(lambda: (trainer.terminate(), trainer.wait()))
        url = stack.enter_context(watching(program, runs))
        sweep_url = stack.enter_context(watching(program, sweep))
        evil_url = stack.enter_context(watching(program, evil))
        empty_url = stack.enter_context(watching(program, place / "empty"))
        live_url = stack.enter_context(watching(program, live))
        goes = place / "goes"
        shutil.copytree(done, goes, symlinks=True)
        goes_url = stack.enter_context(watching(program, goes))
        odd_url = stack.enter_context(watching(program, place / "odd"))
        later_url = stack.enter_context(watching(program, place / "later"))
        map_of = ".stage svg"
        evil_path = "/run/%3Cimg%20src%3Dx%20onerror%3Dwindow.pwned%3D1%3E/seed-0"
        playwright = stack.enter_context(sync_playwright())
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        stack.callback(browser.close)
        for screen in SCREENS:
            for scheme in ("light", "dark"):
                visitor = Visitor(browser, screen, scheme, shots)
                visitor.visit("finished", f"{url}/run/{done.name}", map_of)
                expect(visitor.page.locator(".pill.finished")).to_be_visible()
                expect(visitor.page.get_by_role("checkbox", name=plain.name)).to_be_checked()
                use(visitor.page, f"finished on {visitor.name}")
                visitor.judge(f"finished, used, on {visitor.name}")
                visitor.visit("failing", f"{url}/run/failing", ".note:not(.hidden)")
                expect(visitor.page.locator(".note:not(.hidden)")).to_contain_text("not started again")
                visitor.visit("free", f"{url}/run/free", "tbody td")
                inside = visitor.page.evaluate("(() => { const [a, b] = ['.wide', '.card:has(> * > .wide)'].map(s => document.querySelector(s).getBoundingClientRect().right); return a <= b })()")
                check(f"free on {visitor.name}", inside, "a table is wider than its card")
                visitor.visit("restarts", f"{url}/run/restarts", ".events time")
                visitor.visit("short", f"{url}/run/short", map_of)
                for name, run in odd.items():
                    visitor.visit(name, f"{odd_url}/run/{run.name}", map_of)
                visitor.visit("odd-folder", odd_url, "tbody a")
                visitor.visit("no-text", f"{url}/run/%", ".hero:visible")
                visitor.visit("folder", url, "tbody a")
                visitor.visit("sweep", sweep_url, "tbody a")
                expect(visitor.page.locator(".card tbody a")).to_have_count(6)
                visitor.visit("hostile-folder", evil_url, "tbody a")
                visitor.visit("hostile", evil_url + evil_path, map_of)
                visitor.visit("report", report, "figure svg")
                visitor.letters("report")
                visitor.visit("empty", empty_url, ".hero:visible")
                visitor.visit("later", later_url, ".hero:visible")
                visitor.visit("live", live_url, map_of)
                expect(visitor.page.locator(".pill.running")).to_be_visible()
                steps = visitor.page.locator(".facts").inner_text()
                expect(visitor.page.locator(".facts")).not_to_have_text(steps, timeout=LIMIT_MS)
                visitor.context.close()
        visitor = Visitor(browser, "desktop", "light", shots)
        many = place / "many"
        crowd(many, done)
        many_url = stack.enter_context(watching(program, many))
        visitor.visit("many", many_url, "tbody a")
        expect(visitor.page.locator(".card tbody a")).to_have_count(1000)
        expect(visitor.page.get_by_text("10,000")).not_to_have_count(0)
        look_closer(visitor, live_url, "live, enlarged")
        visitor.visit("going", goes_url, map_of)
        shutil.rmtree(goes)
        expect(visitor.page.get_by_role("alert").filter(has_text="is gone")).to_be_visible(timeout=LIMIT_MS)
        visitor.visit("coming", later_url, ".hero:visible")
        shutil.copytree(done, place / "later", symlinks=True)
        expect(visitor.page.locator(map_of)).to_be_visible(timeout=LIMIT_MS)
        start = time.monotonic()
        visitor.page.goto(live_url)
        expect(visitor.page.locator("h1")).to_be_visible()
        print(f"a page opens in {time.monotonic() - start:.2f} s")
    print(f"{len(faults)} faults; screenshots in {shots}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
