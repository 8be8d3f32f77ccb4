"""Records: the numbers of an array by name, over the same memory, in Python and in kernels.

A subclass of `Record` is a layout: its annotations name the numbers in their order, comments next
to them give unit and meaning. ``float`` and ``int`` are words of 8 bytes; an array, or a list of
records, is ``Annotated`` with its shape; a record may contain others::

    Wheels = Annotated[NDArray[np.float64], 4]

    class Motion(Record):
        speed: Wheels  # [rpm]
        distance: float  # [m]

    MOTION = Motion.layout

    x = Motion.of(array)  # in Python
    x = record_at(array, place, MOTION)  # in a kernel

Neither copies anything: ``x.speed[i]`` is a word of `array`. As an argument of a kernel a record is
one pointer, an array seven numbers.
"""

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

from hilserver.lazily import lazily


def _element(hint: Any) -> type[Any] | None:
    """Return the NumPy type of the elements of an array or a list.

    NumPy spells NDArray in its own way on each version of Python: the type is sought among all
    arguments of the annotation, not at a place of its own.
    """
    if isinstance(hint, type) and issubclass(hint, np.generic):
        return hint
    return next(filter(None, map(_element, get_args(hint))), None)


def _number(hint: Any) -> np.dtype[Any] | None:
    """Return the NumPy type of an annotation, None if it does not name one."""
    if hint in (float, int):
        number: np.dtype[Any] = np.dtype(hint)
        return number
    if get_origin(hint) is Annotated:
        sequence, shape = get_args(hint)
    else:
        sequence, shape = hint, ()
    element = _element(sequence)
    if element is None:
        return None
    return np.dtype((element.layout if issubclass(element, Record) else element, shape))


if TYPE_CHECKING:

    class _Void:
        """The part of NumPy's class in use: its stubs make it final and accept any attribute."""

        base: NDArray[Any]

        def __getitem__(self, name: str) -> Any: ...
        def __setitem__(self, name: str, value: Any) -> None: ...
        def tobytes(self) -> bytes: ...

else:

    class _Void(np.void):
        def __getattr__(self, name: str) -> Any:
            try:
                return self[name]
            except ValueError as error:
                raise AttributeError(str(error)) from None

        def __setattr__(self, name: str, value: Any) -> None:
            self[name] = value


class Record(_Void):
    """Numbers by name; the annotations of a subclass are its layout."""

    layout: ClassVar[np.dtype[Any]]  # for NumPy and numba
    n_words: ClassVar[int]  # its length in words of 8 bytes

    def __init_subclass__(cls, word: type | None = None) -> None:
        """Make the layout; with `word` all numbers have this type instead of their own."""
        own = cls.__mro__[: cls.__mro__.index(Record)]
        hints = {k: v for c in reversed(own) for k, v in c.__annotations__.items()}
        fields = []
        for name, hint in hints.items():
            if hasattr(Record, name) or name in Record.__annotations__:
                raise TypeError(
                    f"{cls.__name__}.{name} would hide what every record has"
                )
            number = _number(hint)
            if number is None:
                raise TypeError(
                    f"{cls.__name__}.{name}: {hint} names no type of number"
                )
            fields.append(
                (name, number if word is None else np.dtype((word, number.shape)))
            )
        cls.layout = np.dtype((cls, np.dtype(fields, align=True)))
        cls.n_words = cls.layout.itemsize // 8

    @classmethod
    def of(cls, array: NDArray[Any], place: int = 0) -> Self:
        """Return the record whose first word is ``array[place]``; it keeps the array alive."""
        record: Self = array[place : place + cls.n_words].view(cls.layout)[0]
        return record

    @classmethod
    def zeros(cls) -> Self:
        """Return a record with memory of its own, all zero."""
        return cls.of(np.zeros(cls.n_words))

    @classmethod
    def where(cls, name: str) -> slice:
        """Return the place of a field's words in an array."""
        fields = cls.layout.fields
        assert fields is not None
        number, offset = fields[name][:2]
        return slice(offset // 8, (offset + number.itemsize) // 8)

    @property
    def numbers(self) -> NDArray[np.float64]:
        """The words of the record in its array."""
        numbers: NDArray[np.float64] = self.base.view(np.float64)
        return numbers

    def copy(self) -> Self:
        """Return a record with memory of its own and the same numbers."""
        return self.of(self.numbers.copy())

    def __reduce__(self) -> Any:
        """Pickle the numbers: a scalar restored by NumPy would be read-only."""
        return self.of, (self.numbers.copy(),)


if TYPE_CHECKING:
    from hilserver.compiled.record_at import assign, record_at
else:
    __getattr__ = lazily("hilserver.compiled", record_at=("assign", "record_at"))

__all__ = ["Record", "assign", "record_at"]
