"""Attributes for clients: completed with stamps, cut to an index range, per user.

=======================  ========================================================================
BadIndexRangeInvalid     not a range, or of a value without elements
BadIndexRangeNoData      a range beyond the existing elements
BadDataEncodingInvalid   an encoding for a value that is not a structure
BadDataEncodingUnsupported  another encoding than Default Binary
=======================  ========================================================================
"""

import re
from datetime import UTC, datetime
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.address_space import AttributeValue

from hilserver.opcua.encoding import FixedDataValue

_Codes, _Attributes = ua.StatusCodes, ua.AttributeIds
_RANGE = re.compile(r"(\d{1,10})(?::(\d{1,10}))?")
_BINARY = "Default Binary"
_NO_VALUE = ua.StatusCode(_Codes.BadWaitingForInitialData)
_BY_USER = {_Attributes.UserAccessLevel, _Attributes.UserExecutable}


def find(address_space: Any, node_id: Any, attribute: int) -> Any:
    """Return the place of an attribute.

    ServiceError: BadNodeIdUnknown or BadAttributeIdInvalid.
    """
    node = address_space.get(node_id)
    if node is None:
        raise ServiceError(_Codes.BadNodeIdUnknown)
    place = node.attributes.get(attribute)
    if place is None:
        raise ServiceError(_Codes.BadAttributeIdInvalid)
    return place


def value_at(place: Any, node_id: Any, attribute: int) -> ua.DataValue:
    """Return the value at a place."""
    if place.value_callback:
        return place.value_callback(node_id, attribute)
    if place.value is None:
        raise ServiceError(_Codes.BadAttributeIdInvalid)
    return place.value


def check_encoding(
    encoding: ua.QualifiedName | None, attribute: int, value: ua.DataValue
) -> None:
    """Raise ServiceError unless the value is available in this encoding."""
    name = None if encoding is None else encoding.Name
    if not name:
        return
    variant = value.Value
    is_structure = (
        variant is not None and variant.VariantType is ua.VariantType.ExtensionObject
    )
    if attribute != _Attributes.Value or not is_structure:
        raise ServiceError(_Codes.BadDataEncodingInvalid)
    if name != _BINARY:
        raise ServiceError(_Codes.BadDataEncodingUnsupported)


def parse_range(text: str | None) -> slice | None:
    """Return the elements of an index range (OPC 10000-4, 7.27), None for all."""
    if not text:
        return None
    bounds = []
    for part in text.split(","):
        found = _RANGE.fullmatch(part)
        if found is None or (found[2] and int(found[1]) >= int(found[2])):
            raise ServiceError(_Codes.BadIndexRangeInvalid)
        bounds.append((int(found[1]), int(found[2] or found[1])))
    if len(bounds) > 1:
        # nothing here has two dimensions
        raise ServiceError(_Codes.BadIndexRangeNoData)
    low, high = bounds[0]
    return slice(low, high + 1)


def cut(value: ua.DataValue, part: slice) -> FixedDataValue:
    """Return the part of an array, a text or a byte string."""
    variant = value.Value
    whole = None if variant is None else variant.Value
    if whole is None:
        return FixedDataValue.of(value)
    if not isinstance(whole, list | str | bytes):
        raise ServiceError(_Codes.BadIndexRangeInvalid)
    found = whole[part]
    if not found:
        raise ServiceError(_Codes.BadIndexRangeNoData)
    piece = ua.Variant(found, variant.VariantType, None, isinstance(whole, list))
    return FixedDataValue(
        piece, value.StatusCode, value.SourceTimestamp, value.ServerTimestamp
    )


class RangePlace(AttributeValue):  # type: ignore[misc]
    """A part of the value at another place."""

    def __init__(self, whole: Any, part: slice) -> None:
        self._whole = whole
        self._part = part
        self._cut_of: Any = None
        self._cut: FixedDataValue
        super().__init__(None)

    @property
    def value(self) -> FixedDataValue:
        """The part; the same object as long as the whole is the same."""
        whole = self._whole.value
        if whole is not self._cut_of:
            try:
                self._cut = cut(whole, self._part)
            except ServiceError as error:
                code = ua.StatusCode(error.code)
                self._cut = FixedDataValue(
                    None, code, whole.SourceTimestamp, whole.ServerTimestamp
                )
            self._cut_of = whole
        return self._cut

    @value.setter
    def value(self, value: object) -> None:
        """Ignore writes."""


def completed(value: ua.DataValue, attribute: int, born: datetime) -> FixedDataValue:
    """Return a value with the stamps and the status that asyncua's own nodes lack."""
    if isinstance(value, FixedDataValue):
        return value
    source = value.SourceTimestamp
    status = value.StatusCode
    if attribute == _Attributes.Value:
        source = source or born
        has_value = (
            value.Value is not None
            and value.Value.VariantType is not ua.VariantType.Null
        )
        if not has_value and (status is None or status.is_good()):
            status = _NO_VALUE
    return FixedDataValue(value.Value, status, source, datetime.now(UTC))


class Reader:
    """Answers for single attributes."""

    def __init__(self, server: Any) -> None:
        self._server = server
        self._born = datetime.now(UTC)

    def read(self, item: Any, user: Any) -> FixedDataValue:
        """Return one attribute; if that is not possible, a value with a bad status."""
        try:
            node_id = item.node_id
            attribute = item.attribute
            place = find(self._server.aspace, node_id, attribute)
            value = value_at(place, node_id, attribute)
            if item.data_encoding.Name:
                check_encoding(item.data_encoding, attribute, value)
            if attribute in _BY_USER:
                value = self._by_user(node_id, attribute, value, user)
            if item.index_range:
                part = parse_range(item.index_range)
                assert part is not None
                value = cut(value, part)
            return completed(value, attribute, self._born)
        except ServiceError as error:
            return self.refused(error.code)

    @staticmethod
    def refused(code: int) -> FixedDataValue:
        """Return a value whose status is the reason why there is none."""
        return FixedDataValue(None, ua.StatusCode(code), None, datetime.now(UTC))

    def _by_user(
        self, node_id: ua.NodeId, attribute: int, value: ua.DataValue, user: Any
    ) -> ua.DataValue:
        if not node_id.NamespaceIndex or value.Value is None or not value.Value.Value:
            return value
        kept = value.Value.Value
        application = self._server.application
        if attribute == _Attributes.UserExecutable:
            kept = kept and application.may_call(user, node_id)
        elif not application.may_write(user, node_id):
            kept &= ~ua.AccessLevel.CurrentWrite.mask
        return ua.DataValue(ua.Variant(kept, value.Value.VariantType), value.StatusCode)


def place_for_items(address_space: Any, item: ua.ReadValueId) -> Any:
    """Return the place for a monitored item; ServiceError with the code of a Read."""
    place = find(address_space, item.NodeId, item.AttributeId)
    part = parse_range(item.IndexRange)
    value = value_at(place, item.NodeId, item.AttributeId)
    check_encoding(item.DataEncoding, item.AttributeId, value)
    if part is None:
        return place
    whole = value.Value
    if whole is not None and not isinstance(whole.Value, list | str | bytes | None):
        raise ServiceError(_Codes.BadIndexRangeInvalid)
    return RangePlace(place, part)
