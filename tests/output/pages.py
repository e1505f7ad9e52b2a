"""A look at a page as a browser takes it: ``from output.pages import Balance``."""

from html.parser import HTMLParser


class Balance(HTMLParser):
    """Collects ids and links, and checks that elements close in the order in which they opened."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in {"meta", "img"}:
            self.open.append(tag)
        self.handle_startendtag(tag, attrs)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids += [value or "" for name, value in attrs if name == "id"]
        self.links += [
            value or "" for name, value in attrs if name in {"href", "src", "xlink:href"}
        ]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
