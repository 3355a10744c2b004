"""A listener to long work."""

from __future__ import annotations


class Heard:
    """Remembers the stages, the news within them, and both in their order; ends work that has ``most`` of them."""

    def __init__(self, most: int | None = None) -> None:
        self.most = most
        self.stages: list[str] = []
        self.news: list[str] = []
        self.told: list[str] = []

    def stage(self, name: str) -> None:
        self.stages.append(name)
        self.told.append(name)

    def update(self, text: str) -> None:
        self.news.append(text)
        self.told.append(text)
        if self.most is not None and len(self.told) > self.most:
            raise TimeoutError(f"no end after {self.most} news: {text}")
