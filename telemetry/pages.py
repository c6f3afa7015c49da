"""HTML pages of templates that come with a package."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template


def page_template(package: str, name: str, filters: Mapping[str, Callable[..., Any]]) -> Template:
    """A template in a package's `templates` folder; what it shows is escaped, what it lacks raises.

    Args:
        package: As Python imports it.
        name: File in the folder.
        filters: By the names under which the template calls them.
    """
    environment = Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= filters
    return environment.get_template(name)
