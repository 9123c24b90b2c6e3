"""What stands for viser where only what it is told matters."""

from types import SimpleNamespace


class Drawn:
    """Stands for viser: it remembers what it is told to draw."""

    def __init__(self):
        self.made = {}

    def __getattr__(self, kind):
        if not kind.startswith("add_"):
            raise AttributeError(kind)

        def add(name, *arguments, **options):
            self.made[name] = SimpleNamespace(arguments=arguments, on_drag=lambda f: f, **options)
            return self.made[name]

        return add
