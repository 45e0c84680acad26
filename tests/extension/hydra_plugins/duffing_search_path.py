"""Let every command find the options in duffing/conf."""

from hydra.core.config_search_path import ConfigSearchPath
from hydra.plugins.search_path_plugin import SearchPathPlugin


class DuffingSearchPath(SearchPathPlugin):
    """Hydra finds it by the name of its folder."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Append our folder to the search path."""
        search_path.append("duffing", "pkg://duffing.conf")
