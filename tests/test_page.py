"""The page (docs/page): the engine's bits in a browser, and what one does with it there."""

import io
import shutil

import numpy as np
import pytest
from PIL import Image

import designrl
from designrl import engine
from designrl.evaluation import episode_seeds
from designrl.simulation import Simulator
from reproduce import page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
COURSES = episode_seeds(page.SEED, page.EPISODES).tolist()
PLAYGROUND = "#playground"
# Bodies between learned ones and the original.
CHANGED = {
    "walker": np.array([0.8, 1.2, 1.0, 1.1, 0.7, 1.25, 0.9, 1.05]),
    "ant": 1 + 0.3 * np.sin(np.arange(36)),
}


@pytest.fixture(scope="module")
def browser():
    reason = "needs playwright (pip install -c requirements-extras.lock playwright) and a chromium"
    playwright = pytest.importorskip("playwright.sync_api", reason=reason)
    if CHROMIUM is None:
        pytest.skip(reason)
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def open_page(browser):
    """open_page(width, scheme): the page as opened from disk; what it asked for and complained of
    is looked at in the end."""
    asked, complaints, contexts = [], [], []

    def open_page(width=1280, scheme="light", **options):
        size = {"width": width, "height": 900}
        contexts.append(browser.new_context(viewport=size, color_scheme=scheme, **options))
        contexts[-1].set_default_timeout(1_800_000)  # ms; a busy machine draws when it can
        opened = contexts[-1].new_page()
        opened.on("request", lambda request: asked.append(request.url))
        opened.on("pageerror", lambda error: complaints.append(str(error)))
        opened.goto(page.TARGET.as_uri())
        opened.wait_for_function("window.designrl")
        return opened

    yield open_page
    for context in contexts:
        context.close()
    assert complaints == []
    own = page.ROOT.as_uri() + "/paper/"
    others = [url for url in asked if not url.startswith((page.TARGET.as_uri(), own, "data:"))]
    assert others == [], "a request leaves the page"


def test_the_page_is_built_from_what_there_is():
    built = page.TARGET.read_text()
    assert f'name="sources" content="{page.digest()}"' in built, "make page"
    assert len(built.encode()) <= page.LIMIT


def test_the_script_has_each_module_once_and_no_imports():
    script = page.script()
    assert "import " not in script.replace("imports and", "")
    for source in page.SOURCE.glob("*.js"):
        first = source.read_text().splitlines()[0]
        assert script.count(first) == 1


def test_thirty_episodes_have_the_bits_of_the_simulator(open_page):
    if reason := engine.missing_reason():
        pytest.skip(reason)
    agents = (
        "biped/seed0",
        "biped-morphology-smaller-leg/seed0",
        "biped-hardcore-morphology/seed0",
        "biped-hardcore/seed0",
        "ant/seed0",
        "ant-morphology/seed2",
    )
    opened = open_page()
    assert set(agents) <= set(opened.evaluate("designrl.agents"))
    compared = 0
    for name in agents:
        agent = designrl.load(page.ROOT / f"pretrained/{name}.safetensors")
        seeds = np.array([[3, 2**40 + 1, *COURSES[:3]]])
        with Simulator(agent.experiment, "engine", agent.network) as simulator:
            result = simulator.rollout(agent.parameters[None], seeds)
        found = [play(opened, name, seed) for seed in seeds[0].tolist()]
        assert [score for score, _ in found] == result.returns[0].tolist()
        assert [steps for _, steps in found] == result.steps[0].tolist()
        compared += len(found)
    assert compared == 30


def play(opened, agent: str, seed: int, design=None) -> tuple[float, int]:
    what = {"agent": agent, "seed": seed, "design": design}
    found = opened.evaluate("what => designrl.play(what)", what)
    return found["score"], found["steps"]


@pytest.mark.parametrize(
    "name", ["biped-morphology/seed0", "biped-hardcore-morphology/seed1", "ant-morphology/seed0"]
)
def test_a_changed_body_has_the_bits_of_the_reference(open_page, name):
    agent = designrl.load(page.ROOT / f"pretrained/{name}.safetensors")
    changed = CHANGED[agent.experiment.body.name]
    expected = designrl.evaluate(agent, 2, page.SEED, backend="reference", design=changed)
    opened = open_page()
    found = [play(opened, name, seed, changed.tolist()) for seed in COURSES[:2]]
    assert found == list(zip(expected.scores, expected.steps, strict=True))


@pytest.mark.parametrize(
    "what, message",
    [
        ({"agent": "nobody", "seed": 0}, "no agent nobody"),
        ({"agent": "biped/seed0", "seed": 0, "design": [1] * 7}, "8 scales from 0.25 to 1.75"),
        ({"agent": "biped/seed0", "seed": 0, "design": [2] * 8}, "8 scales from 0.25 to 1.75"),
        ({"agent": "ant/seed0", "seed": 0, "design": [1] * 8}, "36 scales from 0.25 to 1.75"),
    ],
)
def test_what_cannot_be_played_is_refused(open_page, what, message):
    found = open_page().evaluate("what => designrl.play(what).catch(e => e.message)", what)
    assert message in found


def text(opened, name: str) -> str:
    return opened.inner_text(f"{PLAYGROUND} [data-at={name}]")


def scales(opened) -> list[float]:
    inputs = opened.query_selector_all(f"{PLAYGROUND} input[type=range]")
    found = {int(each.get_attribute("data-index")): float(each.input_value()) for each in inputs}
    return [found[i] for i in range(len(found))]


def sliders_in_view(opened) -> list:
    return opened.query_selector_all(f"{PLAYGROUND} fieldset:not([hidden]) input")


def wait_for_end(opened) -> dict:
    """How the course ends, at sixteen times the speed: then, and what is shown at that moment."""
    opened.select_option(f"{PLAYGROUND} [data-at=speed]", "16")
    ended = f"""() => {{
      const at = (name) => document.querySelector(`{PLAYGROUND} [data-at=${{name}}]`);
      const found = {{ how: at("frame").dataset.end, state: at("truth").dataset.state }};
      for (const name of ["end", "tally", "expected", "here"]) found[name] = at(name).innerText;
      return found.how && found;
    }}"""
    return opened.wait_for_function(ended).json_value()


def picture(opened) -> np.ndarray:
    data = opened.locator(f"{PLAYGROUND} canvas").first.screenshot()
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


def share(pixels: np.ndarray, color) -> float:
    """Of the pixels near a color, in %."""
    return 100 * (np.abs(pixels - color).max(axis=2) < 24).mean()


@pytest.mark.parametrize("agent", [None, "ant-morphology/seed1"])
def test_an_untouched_course_ends_with_evaluates_score(open_page, agent):
    opened = open_page()
    if agent:
        opened.select_option(f"{PLAYGROUND} [data-at=agent]", agent)
    ended = wait_for_end(opened)
    assert (ended["how"], ended["state"]) == ("done", "same")
    assert ended["expected"] == ended["here"]


def test_a_slider_changes_the_body_at_once_and_the_course_goes_on(open_page):
    opened = open_page()
    opened.wait_for_function(f"parseFloat(document.querySelector('{PLAYGROUND} .big').innerText)>5")
    opened.click(f"{PLAYGROUND} [data-at=play]")
    before, picture_before = scales(opened), picture(opened)
    slider = opened.get_by_label("bottom leg 2 width")
    slider.focus()
    for _ in range(10):
        slider.press("ArrowRight")
    assert scales(opened)[6] == pytest.approx(before[6] + 0.5)
    assert text(opened, "expected") == "none: the body changed on the way"
    assert float(text(opened, "score")) > 5
    opened.evaluate(  # a picture follows the slider
        "() => new Promise(drawn => requestAnimationFrame(() => requestAnimationFrame(drawn)))"
    )
    leg = (225, 110, 180)
    assert share(picture(opened), leg) > share(picture_before, leg)


def find_handle(opened) -> tuple[float, float]:
    """A place in the picture where a leg can be taken."""
    box = opened.locator(f"{PLAYGROUND} canvas").first.bounding_box()
    near = f"document.querySelector('{PLAYGROUND} canvas').classList.contains('near')"
    for y in np.arange(0.9, 0.3, -0.03) * box["height"] + box["y"]:  # from below: a foot
        for x in np.arange(0.2, 0.7, 0.015) * box["width"] + box["x"]:
            opened.mouse.move(x, y)
            if opened.evaluate(near):
                return x, y
    raise AssertionError("there is no handle in the picture")


@pytest.mark.parametrize("agent, pulled", [(None, 1), ("ant-morphology/seed0", 2)])
def test_a_leg_is_dragged_and_the_agent_walks_on(open_page, agent, pulled):
    opened = open_page()
    if agent:
        opened.select_option(f"{PLAYGROUND} [data-at=agent]", agent)
    opened.evaluate(
        f"document.querySelector('{PLAYGROUND}').scrollIntoView({{behavior: 'instant'}})"
    )
    opened.click(f"{PLAYGROUND} [data-at=play]")
    before, (x, y) = scales(opened), find_handle(opened)
    opened.mouse.down()
    opened.mouse.move(x + 25, y + 25, steps=3)
    opened.mouse.move(x - 60, y - 60, steps=3)
    opened.mouse.up()
    changed = [i for i, (a, b) in enumerate(zip(before, scales(opened), strict=True)) if a != b]
    assert len(changed) == pulled
    leg = opened.query_selector(f"{PLAYGROUND} [data-at=legs] [aria-pressed=true]")
    if agent:  # its sliders are seen
        slider = opened.query_selector(f"{PLAYGROUND} input[data-index='{changed[0]}']")
        assert slider.get_attribute("aria-label").startswith(leg.inner_text())
    start = float(text(opened, "time").split()[0])
    opened.mouse.move(0, 0)
    opened.click(f"{PLAYGROUND} [data-at=play]")
    opened.wait_for_function(
        f"parseFloat(document.querySelector('{PLAYGROUND} [data-at=time]').innerText) > {start + 1}"
    )


def test_a_finger_drags_a_leg_and_scrolls_elsewhere(open_page):
    opened = open_page(width=400, has_touch=True)
    opened.click(f"{PLAYGROUND} [data-at=play]")
    before = scales(opened)
    found = opened.evaluate(
        """() => {
          const canvas = document.querySelector('#playground canvas');
          const {width, height} = canvas.getBoundingClientRect();
          const tell = (kind, x, y) => canvas.dispatchEvent(new PointerEvent(kind, {
            pointerId: 1, pointerType: 'touch', clientX: x + canvas.getBoundingClientRect().x,
            clientY: y + canvas.getBoundingClientRect().y, bubbles: true}));
          canvas.setPointerCapture = () => {};
          tell('pointerdown', width - 5, 5);  // the sky
          const far = canvas.classList.contains('holding');
          tell('pointerup', width - 5, 5);
          tell('pointerdown', width * 0.36, height * 0.75);  // under the walker
          const near = canvas.classList.contains('holding');
          tell('pointermove', width * 0.36 - 30, height * 0.75 - 40);
          tell('pointerup', 0, 0);
          return [far, near];
        }"""
    )
    assert found == [False, True]
    assert scales(opened) != before


def test_a_fall_is_seen_and_counted_and_the_next_course_begins(open_page):
    opened = open_page()
    opened.select_option(f"{PLAYGROUND} [data-at=agent]", "biped-hardcore/seed0")
    opened.click(f"{PLAYGROUND} [data-at=worst]")
    course = opened.input_value(f"{PLAYGROUND} [data-at=course]")
    ended = wait_for_end(opened)
    assert (ended["how"], ended["state"]) == ("fell", "same")
    assert "it fell" in ended["end"] and ended["tally"] == "1 fall in 1 course"
    opened.wait_for_function(
        f"document.querySelector('{PLAYGROUND} [data-at=course]').value != {course}"
    )


def test_an_episode_has_the_command_lines_number_and_bad_input_changes_nothing(open_page):
    opened = open_page()
    episode, seed = (
        opened.locator(f"{PLAYGROUND} [data-at={name}]") for name in ("course", "seed")
    )
    opened.click(f"{PLAYGROUND} [data-at=worst]")
    name = opened.input_value(f"{PLAYGROUND} [data-at=agent]")
    agent = designrl.load(page.ROOT / f"pretrained/{name}.safetensors")
    assert int(episode.input_value()) == page.agents()[name].returns.argmin()
    episode.fill("7")
    episode.press("Enter")
    scores = designrl.evaluate(agent, 8, page.SEED).scores
    assert (text(opened, "expected"), seed.input_value()) == (str(scores[7]), str(COURSES[7]))
    episode.press("ControlOrMeta+A")
    for wrong in ("-5", "100", "e", "1.5"):
        episode.press_sequentially(wrong)
        episode.press("Enter")
        assert (episode.input_value(), seed.input_value()) == ("7", str(COURSES[7]))
        episode.press("ControlOrMeta+A")
    seed.fill("12345")
    seed.press("Enter")
    for wrong in ("abc", "-5", ""):
        seed.fill(wrong)
        seed.press("Enter")
        assert seed.input_value() == "12345"
    assert text(opened, "expected") == "none of this seed"


def test_every_agent_can_be_chosen_and_brings_its_body(open_page):
    opened = open_page()
    names = opened.evaluate("designrl.agents")
    assert sorted(names) == sorted(page.agents())
    for name in names[::5]:
        opened.select_option(f"{PLAYGROUND} [data-at=agent]", name)
        expected = designrl.load(page.ROOT / f"pretrained/{name}.safetensors").scales
        np.testing.assert_allclose(scales(opened), expected, atol=1e-9)
        assert 0 < len(sliders_in_view(opened)) <= 9


@pytest.mark.parametrize("scheme, tile", [("light", (180, 197, 240)), ("dark", (58, 68, 128))])
def test_the_ants_picture_has_all_its_parts(open_page, scheme, tile):
    opened = open_page(scheme=scheme)
    opened.select_option(f"{PLAYGROUND} [data-at=agent]", "ant/seed0")
    opened.click(f"{PLAYGROUND} [data-at=play]")
    seen = picture(opened)
    assert share(seen, tile) > 5
    for part in ((90, 90, 107), (217, 140, 51), (242, 191, 89)):
        assert share(seen, part) > 0.2


def test_two_ants_run_side_by_side_and_one_shows_how_its_body_came_about(open_page):
    opened = open_page()
    opened.select_option("#side-by-side [data-at=ground]", "ant")
    opened.evaluate("document.querySelector('#side-by-side').scrollIntoView()")
    opened.wait_for_function(
        "[0, 1].every(i => parseFloat(document.querySelector("
        "`#side-by-side [data-at=score-${i}]`).innerText) > 10)"
    )
    for i, name in enumerate(("ant", "ant-morphology")):
        runs = {key: score for key, score in page.agents().items() if key.split("/")[0] == name}
        best = max(runs, key=lambda key: runs[key].mean)
        assert opened.inner_text(f"#side-by-side [data-at=name-{i}]").endswith(f"seed {best[-1]}")
        mean = f"mean over 100 courses: {runs[best].mean:.1f}"
        assert opened.inner_text(f"#side-by-side [data-at=mean-{i}]") == mean
    opened.select_option("#history [data-at=run]", "ant-morphology/seed0")
    slider = opened.locator("#history input")
    slider.fill("0")
    walks, evaluated = (opened.locator(f"#history [data-at={at}]") for at in ("walks", "evaluated"))
    both = "body and policy of generation"
    assert walks.inner_text() == f"{both} 0: the recorded distribution, untrained"
    slider.fill("7900")
    assert walks.inner_text() == "body of generation 7,900, policy of generation 8,000"
    assert evaluated.inner_text().startswith("evaluation of generation 7,")
    slider.fill("8000")
    assert walks.inner_text() == f"{both} 8,000: the recorded distribution"
    slider.fill("16000")
    kept = designrl.load(page.ROOT / "pretrained/ant-morphology/seed0.safetensors").metadata
    assert walks.inner_text() == f"{both} {kept['generation']:,}: the published agent"


@pytest.mark.parametrize("width", [400, 1600])
@pytest.mark.parametrize("scheme, sky", [("light", (225, 225, 255)), ("dark", (40, 38, 80))])
def test_the_picture_has_all_its_parts_and_the_page_does_not_scroll_sideways(
    open_page, width, scheme, sky
):
    opened = open_page(width, scheme)
    opened.click(f"{PLAYGROUND} [data-at=play]")
    seen = picture(opened)
    assert share(seen, sky) > 20
    assert share(seen, (160, 105, 255)) > 0.5  # the hull
    ground = (112, 184, 96) if scheme == "light" else (60, 122, 60)
    assert share(seen, ground) > 2
    assert opened.evaluate("document.documentElement.scrollWidth") <= width
    tables = "[...document.querySelectorAll('#results .scroll')]"
    assert opened.evaluate(f"{tables}.every(each => each.scrollWidth <= each.clientWidth)")
