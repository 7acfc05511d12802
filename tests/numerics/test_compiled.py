"""Functions are compiled where nothing can be kept, too."""

from numba.core import caching

from rigtool.numerics.compiled import compiled


def twice(value):
    return 2 * value


def test_without_a_place_for_machine_code(monkeypatch):
    def none(cls, *arguments):
        return None

    for locator in caching._CacheLocator.__subclasses__():
        monkeypatch.setattr(locator, "from_function", classmethod(none))
    assert compiled(twice)(21) == 42
