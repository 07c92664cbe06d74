"""Test what people do on the studio's page beside the main way: paste, drag, chains, phones."""

import io

import numpy as np
import pytest
from PIL import Image
from studio_pages import after, fetched, fill, previewed, run, same_by, take, until


@pytest.mark.full
def test_pasted_pictures_and_landmarks_that_are_moved(opened, pictures):
    page = opened()
    for path in pictures:
        count = page.evaluate("studio.state.pictures.length")
        page.evaluate(
            """([bytes, name]) => { const data = new DataTransfer();
            data.items.add(new File([new Uint8Array(bytes)], name, { type: "image/png" }));
            document.dispatchEvent(
                new ClipboardEvent("paste", { clipboardData: data, bubbles: true })); }""",
            [list(path.read_bytes()), path.name],
        )  # fmt: skip
        until(page, f"studio.state.pictures.length === {count + 1}")
    previewed(page)
    page.locator("#shown .frame").nth(0).click(position={"x": 30, "y": 30})
    other = page.locator("#shown .frame").nth(1)
    after(page, lambda: other.click(position={"x": 60, "y": 60}))
    assert page.evaluate("studio.landmarks.pairs().length") == 1
    before = page.evaluate("studio.landmarks.pairs()[0][0]")
    mark = page.get_by_role("button", name="Landmark 1 in A").bounding_box()
    middle = mark["x"] + mark["width"] / 2, mark["y"] + mark["height"] / 2
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + 40, middle[1] + 15, steps=4)
    after(page, page.mouse.up)
    box = page.locator("#shown .frame img").nth(0).bounding_box()
    moved = page.evaluate("studio.landmarks.pairs()[0][0]")
    assert moved[0] - before[0] == pytest.approx(40 / box["width"] * 60, abs=0.3)
    assert moved[1] - before[1] == pytest.approx(15 / box["height"] * 48, abs=0.3)
    page.get_by_role("button", name="Landmark 1 in B").focus()
    after(page, lambda: page.keyboard.press("ArrowRight"))
    assert "--landmark" in page.input_value("#command")
    after(page, lambda: page.keyboard.press("Delete"))
    assert page.evaluate("studio.landmarks.pairs().length") == 0
    assert "--landmark" not in page.input_value("#command")


@pytest.mark.full
def test_a_chain_and_all_its_files(opened, pictures, place):
    third = place / "c.png"
    Image.fromarray(np.full((40, 40, 3), 90, np.uint8)).save(third)
    page = opened()
    chain = [*pictures, third]
    take(page, chain)
    assert not page.is_visible("#guide")
    page.click("#kind-recolor")
    until(page, "!document.getElementById('failure').hidden")
    assert "3 pictures given: expected 2" in page.inner_text("#failure")
    assert page.is_disabled("#run")
    page.click("#kind-morph")
    fill(page, size="24", frames="3")
    previewed(page)
    run(page)
    assert page.evaluate("studio.state.view.contentWindow.clmorph.times.length") == 5
    assert same_by(page, "command", place / "chain", chain, "morph.gif") == fetched(page, "gif")
    with Image.open(io.BytesIO(fetched(page, "webp"))) as film:
        assert film.n_frames == 5
    assert fetched(page, "html").startswith(b"<!doctype html>")
    assert fetched(page, "mp4")[4:8] == b"ftyp"


@pytest.mark.full
def test_the_command_is_that_of_a_run_whose_result_comes_before_its_answer(page, pictures, place):
    """On a busy machine a small run ends before the answer to its request is read."""
    previewed(page)
    page.evaluate(
        """() => { const plain = window.fetch;
        window.fetch = async (path, ...more) => { const answer = await plain(path, ...more);
            if (path.endsWith("/run")) while (document.getElementById("downloads").hidden)
                await new Promise((resolve) => setTimeout(resolve, 10));
            return answer; }; }"""
    )
    fill(page, size="24", frames="3")
    run(page)
    assert "--frames 3" in page.input_value("#command")
    assert same_by(page, "command", place / "late", pictures, "morph.gif") == fetched(page, "gif")


@pytest.mark.full
def test_pictures_of_one_name_keep_apart(opened, pictures, place):
    """The command needs names that differ, those of painted regions included."""
    (place / "other").mkdir()
    Image.open(pictures[1]).transpose(Image.Transpose.ROTATE_90).save(place / "other/b.png")
    Image.open(pictures[1]).convert("L").save(place / "other/b.jpg")
    page = opened()
    take(page, [pictures[1], place / "other/b.png"])
    assert [each["name"] for each in page.evaluate("studio.state.pictures")] == ["b.png", "b-2.png"]
    page.set_input_files("#choose", str(place / "other/b.jpg"))
    until(page, "studio.state.pictures.length === 3")
    assert page.evaluate("studio.state.pictures[2].name") == "b-3.jpg"


@pytest.mark.full
def test_every_tab_has_room_on_a_phone(opened, pictures):
    page = opened(viewport={"width": 390, "height": 800}, is_mobile=True, has_touch=True)
    take(page, pictures)
    for kind in ("rearrange", "recolor", "mix", "morph"):
        page.tap(f"#kind-{kind}")
        previewed(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390, kind
    page.tap("#use-brush")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    # By keyboard alone the run can be reached from the pictures.
    page.focus("#samples")
    for _ in range(40):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == "run":
            break
    else:
        pytest.fail("the button that runs was not reached")
