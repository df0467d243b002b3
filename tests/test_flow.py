"""The picture of the flow of data is what the code gives."""

from tests.flow import PICTURE, draw, read


def test_the_picture_is_drawn_from_the_code():
    drawn = draw(read())
    assert PICTURE.read_text(encoding="utf-8") == drawn, "docs/images/flow.svg: run make reference"
