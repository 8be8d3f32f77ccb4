"""Who is remembered: a logged-in browser longer than any number of anonymous ones."""

from hilserver.io.page.browsers import MAX_BROWSERS, Browsers


class Hand:
    """A session that is closed when its browser is forgotten."""

    def __init__(self):
        self.is_closed = False

    async def close(self):
        self.is_closed = True


async def test_anonymous_browsers_log_nobody_out():
    browsers = Browsers(Hand)
    user, anonymous = await browsers.new(), await browsers.new()
    user.user = "olga"
    for _ in range(2 * MAX_BROWSERS):
        await browsers.new()
    assert browsers.find(user.key) is user
    assert not user.hand.is_closed
    assert browsers.find(anonymous.key) is None
    assert anonymous.hand.is_closed
    assert len(browsers._by_key) == MAX_BROWSERS
