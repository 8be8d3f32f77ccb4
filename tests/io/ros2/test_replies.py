"""Replies to a client of rmw_fastrtps whose reader comes to be known after its request."""

import socket
from types import SimpleNamespace

import pytest

from hilserver.io.ros2 import replies as module
from hilserver.io.ros2.replies import MOST_WAITING, Replies

TOPIC, CDR = "rr/hilserver/list_parametersReply", b"\0\1\0\0answer"
GIVEN_UP = []
READER, SERVICE, CLIENT = (bytes([n]) * 16 for n in (1, 2, 3))


class Discovery:
    """What is known of one client: its writer at once, its reader when it is `found`."""

    def __init__(self, port):
        self.client = SimpleNamespace(gid=CLIENT, participant=CLIENT[:12])
        self.writers, self.readers = {7: self.client}, []
        self.neighbour = SimpleNamespace(addresses=[("127.0.0.1", port)])

    def look(self):
        pass

    def participant_of(self, writer):
        return self.neighbour

    def replies_to(self, topic, participant):
        assert (topic, participant) == (TOPIC, self.client.participant)
        return self.readers


@pytest.fixture
def client():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        ours.bind(("127.0.0.1", 0))
        ours.setblocking(False)
        yield ours


@pytest.fixture
def rig(client):
    discovery = Discovery(client.getsockname()[1])
    replies = Replies(discovery, lambda *said: GIVEN_UP.append(said), local=True)
    GIVEN_UP.clear()
    yield discovery, replies
    replies.close()


def ask(replies):
    request = SimpleNamespace(writer=7)
    service = SimpleNamespace(subject=SimpleNamespace(topic=TOPIC), gid=SERVICE)
    replies.send(service, request, replies.number(request), CDR)


def test_a_reply_waits_for_the_news_of_its_reader_and_is_sent_once(client, rig):
    discovery, replies = rig
    ask(replies)
    replies.send_waiting()
    with pytest.raises(BlockingIOError):
        client.recv(2000)
    discovery.readers = [READER]
    replies.send_waiting()
    assert CDR in client.recv(2000)
    replies.send_waiting()
    with pytest.raises(BlockingIOError):
        client.recv(2000)


def test_a_reply_to_nobody_is_given_up_and_many_are_few(client, rig, monkeypatch):
    _, replies = rig
    now_s = 100.0
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now_s))
    for _ in range(2 * MOST_WAITING):
        ask(replies)
    assert len(replies._waiting) == len(GIVEN_UP) == MOST_WAITING
    now_s += module.KNOWN_WITHIN_S
    replies.send_waiting()
    assert not replies._waiting
    assert len(GIVEN_UP) == 2 * MOST_WAITING
    topic, sentence = GIVEN_UP[-1]
    assert topic == TOPIC
    assert sentence.startswith("an answer of /hilserver/list_parameters was not sent")
    assert "start the client anew" in sentence
