"""When a changed value causes a notification (OPC 10000-4, 7.22.2; OPC 10000-8, 6.2).

The reference is the value reported last, not the one sampled last, so that a slow drift is reported
when it exceeds the band.
"""

import math
from dataclasses import dataclass
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.ua import uaprotocol_auto

from hilserver.opcua.encoding import FixedDataValue

_Trigger, _Deadband, _Codes = ua.DataChangeTrigger, ua.DeadbandType, ua.StatusCodes
_STATUS_VALUE = _Trigger.StatusValue
_NUMBERS = {kind for kind in ua.VariantType if 2 <= kind.value <= 11}  # SByte to Double


@dataclass(frozen=True, slots=True)
class ChangeFilter:
    """Which part of a value must change, and by how much."""

    trigger: ua.DataChangeTrigger = _STATUS_VALUE
    # changes up to this, in the variable's unit, are not reported; 0 reports any
    band: float = 0.0

    def is_worth_reporting(
        self, last: FixedDataValue | None, new: FixedDataValue
    ) -> bool:
        """Whether `new` is to be reported after `last`, which was reported before."""
        if last is None:
            return True
        if self.trigger is _STATUS_VALUE and not self.band:
            return last.content != new.content
        if last.code != new.code:
            return True
        if self.trigger == _Trigger.Status:
            return False
        if self._has_changed(last.Value, new.Value):
            return True
        is_stamp_of_interest = self.trigger == _Trigger.StatusValueTimestamp
        return bool(
            is_stamp_of_interest and last.SourceTimestamp != new.SourceTimestamp
        )

    def _has_changed(self, last: Any, new: Any) -> bool:
        old_value = None if last is None else last.Value
        new_value = None if new is None else new.Value
        if self.band == 0.0:
            return bool(old_value != new_value)
        pairs = _pairs(old_value, new_value)
        # `not <=` also reports a value that has become NaN.
        return pairs is None or any(not abs(b - a) <= self.band for a, b in pairs)


def _pairs(old: Any, new: Any) -> list[tuple[float, float]] | None:
    """Return the numbers to compare, None if the two have no difference."""
    if not isinstance(old, list):
        old = [old]
        new = [new]
    if not isinstance(new, list) or len(old) != len(new):
        return None
    if not all(isinstance(number, int | float) for number in (*old, *new)):
        return None
    return list(zip(old, new, strict=True))


def change_filter(
    asked: Any, attribute: int, kind: ua.VariantType | None, eu_range: ua.Range | None
) -> ChangeFilter:
    """Return the filter that a client requests.

    ServiceError: BadFilterNotAllowed or BadDeadbandFilterInvalid.
    """
    if asked is None or _is_empty(asked):
        return ChangeFilter()
    if not isinstance(
        asked, uaprotocol_auto.DataChangeFilter
    ):  # asyncua decodes this one
        raise ServiceError(_Codes.BadFilterNotAllowed)
    if not isinstance(asked.Trigger, _Trigger):
        raise ServiceError(_Codes.BadMonitoredItemFilterInvalid)
    if asked.DeadbandType == _Deadband.None_:
        return ChangeFilter(asked.Trigger)
    if attribute != ua.AttributeIds.Value or kind not in _NUMBERS:
        raise ServiceError(_Codes.BadFilterNotAllowed)
    size = asked.DeadbandValue
    if not math.isfinite(size) or size < 0:
        raise ServiceError(_Codes.BadDeadbandFilterInvalid)
    if asked.DeadbandType == _Deadband.Absolute:
        return ChangeFilter(asked.Trigger, size)
    if asked.DeadbandType != _Deadband.Percent or size > 100:
        raise ServiceError(_Codes.BadDeadbandFilterInvalid)
    if eu_range is None:
        raise ServiceError(_Codes.BadFilterNotAllowed)
    return ChangeFilter(asked.Trigger, size / 100 * (eu_range.High - eu_range.Low))


def _is_empty(asked: Any) -> bool:
    return isinstance(asked, ua.ExtensionObject) and asked.TypeId == ua.NodeId(
        ua.ObjectIds.Null
    )
