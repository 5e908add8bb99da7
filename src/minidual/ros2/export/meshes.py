"""Mesh files of the exported description, copied under names of their own."""

import shutil
from pathlib import Path

_SIDE_FILES = (".mtl",)
"""Endings of files that a mesh reads from its own folder."""


class MeshFiles:
    """Gives each mesh file a place in the package, and copies them.

    Args:
        package: Name of the package of description.
    """

    def __init__(self, package: str) -> None:
        self._package = package
        self._sources: dict[str, Path] = {}

    def uri(self, kind: str, source: Path) -> str:
        """Return the address of a mesh in the package.

        Args:
            kind: Folder below `meshes`: "visual" or "collision".
            source: Its file.
        """
        return f"package://{self._package}/{self.place(kind, source)}"

    def place(self, kind: str, source: Path) -> str:
        """Return the path of a mesh below the package's folder; see `uri`.

        Two files of one name stay apart by the names of the folders above them.
        """
        name = source.name
        for folder in source.parents:
            place = f"meshes/{kind}/{name}"
            if self._sources.setdefault(place, source) == source:
                return place
            name = f"{folder.name}_{name}"
        raise ValueError(f"no free name for {source}")

    def copy_to(self, folder: Path) -> list[str]:
        """Copy the files into the package's folder; return their places."""
        for place, source in self._sources.items():
            target = folder / place
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)
            for ending in _SIDE_FILES:
                beside = source.with_suffix(ending)
                if beside.is_file():
                    shutil.copyfile(beside, target.with_suffix(ending))
        return sorted(self._sources)
