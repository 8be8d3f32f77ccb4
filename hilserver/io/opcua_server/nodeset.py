"""The address space as a NodeSet2 file (OPC 10000-6, annex F), for tools that read such files.

The robot stands below Objects, not below DI's DeviceSet as in the running server, so that the file
loads into tools that do not have the DI model. `nodeset.xml.j2` is its template.
"""

from collections.abc import Iterable
from xml.sax.saxutils import escape

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from hilserver import __version__
from hilserver.io.opcua_server import model
from hilserver.io.opcua_server.method_table import METHODS
from hilserver.io.opcua_server.units import NAMESPACE_URI as UNITS_URI
from hilserver.parameters import Parameter
from hilserver.signals import SignalTable


def to_nodeset(table: SignalTable, parameters: Iterable[Parameter] = ()) -> str:
    """Return the address space of `table` and `parameters` as the text of a NodeSet2 file."""
    environment = Environment(
        loader=PackageLoader("hilserver.io.opcua_server", "."),
        autoescape=True,
        finalize=_as_xml,
        keep_trailing_newline=True,
        lstrip_blocks=True,
        trim_blocks=True,
        undefined=StrictUndefined,
    )
    folders, variables = model.describe(table, parameters)
    return environment.get_template("nodeset.xml.j2").render(
        folders=folders,
        methods=METHODS,
        model=model,
        units_uri=UNITS_URI,
        variables=variables,
        version=__version__,
    )


def _as_xml(value: object) -> Markup:
    """Return text escaped for XML: unlike HTML this leaves an apostrophe as it is."""
    return (
        value
        if isinstance(value, Markup)
        else Markup(escape(str(value), {'"': "&quot;"}))  # noqa: S704
    )
