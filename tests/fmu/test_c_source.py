"""Kernels as C: what gcc makes of it computes the bits of what numba has compiled."""

import ctypes
import math
import random
import struct
import subprocess

import numba
import pytest

from hilserver.errors import FailedError
from hilserver.fmu.c_source import translate

TABLE = (0.25, -1.5, 3.0, 1e-9)
SIGNATURE = numba.float64(numba.float64, numba.float64, numba.int64, numba.int64)


@numba.njit(error_model="numpy")
def walk(a, n):
    """A loop with two values that change places, which a jump has to set at once."""
    x, y = a, 1.0
    for k in range(n & 7):
        x, y = y, x + TABLE[k & 3]
    return x - y


def mixed(a, b, n, m):
    """Operations that the plant's kernels have, and their special cases."""
    whole = (n ^ (m << 3)) + n * 5 - (m & 1023)
    shifted = (n >> 3) + (n % 7) - n // 9
    hashed = numba.uint64(n) * numba.uint64(0x9E3779B97F4A7C15) >> numba.uint64(11)
    found = math.sin(a) * b + math.floor(b) - a % 3.0 + hashed * 2.0**-53
    found += max(a, b) - min(a, 0.0) + math.copysign(1.0, b) + math.hypot(a, b)
    found += -a if a <= b else abs(b)
    if a != a or not b < 4.0:
        found -= math.exp(min(abs(b), 3.0))
    return found + whole * 1e-3 + shifted + walk(b, n) + (1.0 if n < m else 2.0)


@pytest.fixture(scope="module")
def compiled():
    made = numba.cfunc(SIGNATURE, nopython=True, error_model="numpy", _nrt=False)(mixed)
    return made, str(made._library._final_module)


def kernel_of(listing):
    return next(
        line.partition("@")[2].partition("(")[0]
        for line in listing.splitlines()
        if line.startswith("define") and "5mixed" in line
    )


def bits(number):
    return "nan" if math.isnan(number) else struct.pack("d", number)


def test_it_computes_the_same_bits(compiled, tmp_path):
    made, listing = compiled
    source = translate(listing, kernel_of(listing), "mixed")
    source += """
double run(double a, double b, long n, long m) {
    double y;
    char *error;
    mixed((char *)&y, (char *)&error, a, b, n, m);
    return y;
}
"""
    (tmp_path / "mixed.c").write_text(source)
    words = ["gcc", "-O2", "-w", "-shared", "-fPIC", "mixed.c", "-o", "mixed.so", "-lm"]
    subprocess.run(words, cwd=tmp_path, check=True)
    run = ctypes.CDLL(str(tmp_path / "mixed.so")).run
    run.restype, run.argtypes = (
        ctypes.c_double,
        [ctypes.c_double] * 2 + [ctypes.c_long] * 2,
    )
    rng = random.Random(3)
    special = [0.0, -0.0, math.inf, -math.inf, math.nan, 5e-324, 1e308, 4.0, -3.0]
    numbers = [*special, *(rng.gauss(0.0, 10.0) for _ in range(40))]
    wholes = [
        0,
        1,
        -1,
        2**62,
        -(2**62),
        *(rng.randrange(-(2**40), 2**40) for _ in range(20)),
    ]
    for a in numbers:
        for b in numbers:
            n, m = rng.choice(wholes), rng.choice(wholes)
            assert bits(run(a, b, n, m)) == bits(made.ctypes(a, b, n, m)), (a, b, n, m)


@pytest.mark.parametrize(
    "line",
    [
        "%x = add <2 x i64> %a, %a",
        "%x = call double @llvm.tanh.f64(double %a)",
        "%x = cmpxchg ptr %a, i64 0, i64 1 monotonic monotonic",
    ],
)
def test_what_c_has_not_is_named(line):
    listing = f"define void @k(double %a) {{\nentry:\n  {line}\n  ret void\n}}\n"
    with pytest.raises(FailedError, match="the kernels' machine code"):
        translate(listing, "k", "k")
