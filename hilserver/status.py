"""OPC UA status codes that travel with values (OPC 10000-6, annex A)."""

GOOD = 0x00000000
GOOD_LOCAL_OVERRIDE = 0x00960000
UNCERTAIN = 0x40000000
UNCERTAIN_NO_COMMUNICATION = 0x408F0000  # NoCommunicationLastUsableValue
UNCERTAIN_LAST_USABLE_VALUE = 0x40900000
BAD = 0x80000000  # the bit that every code without a usable value has
BAD_WAITING_FOR_INITIAL_DATA = 0x80320000
BAD_SENSOR_FAILURE = 0x808C0000
BAD_OUT_OF_SERVICE = 0x808D0000
BAD_NO_DATA = 0x809B0000


def is_bad(code: int) -> bool:
    """Whether its value is not usable (OPC 10000-4, 7.39)."""
    return bool(code & BAD)
