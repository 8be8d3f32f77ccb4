"""Closures of types: what is a subtype of what, walked once for each state of the address space.

asyncua walks the tree of types anew for every reference that a Browse looks at.
"""

from typing import Any

from asyncua import ua

_HAS_SUBTYPE = ua.NodeId(ua.ObjectIds.HasSubtype)


class TypeTree:
    """Subtypes of the types of an address space; nodes may be added, types stay what they are."""

    def __init__(self, address_space: Any) -> None:
        self._address_space = address_space
        self._closures: dict[ua.NodeId, frozenset[ua.NodeId]] = {}
        self._size = 0

    def closure(self, type_id: ua.NodeId) -> frozenset[ua.NodeId]:
        """Return a type and all its subtypes."""
        size = len(self._address_space._nodes)
        if size != self._size:
            self._closures.clear()
            self._size = size
        found = self._closures.get(type_id)
        if found is None:
            found = self._walk(type_id)
            if type_id in self._address_space:  # or strangers would fill the memory
                self._closures[type_id] = found
        return found

    def _walk(self, type_id: ua.NodeId) -> frozenset[ua.NodeId]:
        found, rest = {type_id}, [type_id]
        while rest:
            node = self._address_space.get(rest.pop())
            for reference in node.references if node is not None else ():
                if (
                    reference.IsForward
                    and reference.ReferenceTypeId == _HAS_SUBTYPE
                    and reference.NodeId not in found
                ):
                    found.add(reference.NodeId)
                    rest.append(reference.NodeId)
        return frozenset(found)
