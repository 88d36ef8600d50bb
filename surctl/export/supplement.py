"""What an application adds to the bundle of its controller: files, texts, entries of the manifest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable
from surctl.ir import Real

if TYPE_CHECKING:
    from surctl.export.listed import Listed

__all__ = ["Supplement"]

Vector = NDArray[np.float64]


class Supplement:
    """Additions to a bundle. This class adds nothing; an application derives a class and overrides what it adds.

    Example:
        >>> from surctl.export import Supplement
        >>> from surctl.export.bundle import build_bundle
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Action, Controller
        >>> class Licence(Supplement):
        ...     @property
        ...     def files(self):
        ...         return {"NOTICE.txt": "Pump controller of plant 7.\\n"}
        >>> level = Layout((Port("level", (1,), "m", "measured"),))
        >>> drive = Layout((Port("drive", (1,), "V", "of the pump"),))
        >>> pump = Controller("pump", 0.1, level, drive, lambda x, u, p: Action(-2.0 * u["level"]))
        >>> bundle = build_bundle(pump, {}, supplement=Licence())
        >>> bundle.files["NOTICE.txt"]
        'Pump controller of plant 7.\\n'
    """

    @property
    def files(self) -> dict[str, str]:
        """Return the texts of further files by name, such as certificates."""
        return {}

    def fed(self, law: Exportable) -> tuple[str, ...]:
        """Return the names of gains that code of the bundle writes itself while it runs."""
        del law
        return ()

    def templates(self, law: Exportable) -> dict[str, str]:
        """Return the names of templates in `surctl/export/templates`, by the name of the C file that each makes."""
        del law
        return {}

    def values(self, law: Exportable, real: Real) -> dict[str, Any]:
        """Return values of the templates; they replace those of the core, see `wiring_values`."""
        del law, real
        return {}

    def entries(self, law: Exportable, p: Vector) -> dict[str, Any]:
        """Return further entries of the manifest; p (np,) are the gains."""
        del law, p
        return {}

    def lists(self, law: Exportable) -> dict[str, Listed]:
        """Return further instruction lists by file name, beside that of the law."""
        del law
        return {}

    def check(self, manifest: Mapping[str, Any], files: Mapping[str, str]) -> None:
        """Raise InputError if an addition does not belong to the controller of this manifest and these files."""
