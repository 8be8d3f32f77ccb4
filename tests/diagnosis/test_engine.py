"""What holds for every diagnosis, whatever it finds."""

from hilserver_injector import Recipe, make
from threadpoolctl import threadpool_info, threadpool_limits

from benchmarks.diagnose_worker import measured
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.engine import diagnose


def blas_threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_linear_algebra_keeps_to_one_thread_and_gives_the_others_back():
    """Its products are small: a second thread only waits, and takes the CPU of others."""
    recipe, seen = Recipe(seed=1, duration_s=20.0), set()
    with threadpool_limits(2, "blas"):
        before = blas_threads()
        diagnose(
            measured(make(recipe)[0], recipe),
            assemble(None),
            progress=lambda text, share: seen.update(blas_threads()),
        )
        assert seen == {1}
        assert blas_threads() == before
