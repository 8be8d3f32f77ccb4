"""What other programs of this computer reveal about the domains that they are in."""

from hilserver.io.ros2.neighbours import other_domains

HEAD = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid\n"


def listed(tmp_path, *ports):
    file = tmp_path / "udp"
    lines = (
        f"  0: 00000000:{port:04X} 00000000:0000 07 00000000:00000000\n"
        for port in ports
    )
    file.write_text(HEAD + "".join(lines), encoding="ascii")
    return file


def test_ports_tell_the_domains_of_others(tmp_path):
    ports = (7400, 7410, 7411, 7400 + 250 * 42 + 12, 7400 + 250 * 87 + 10, 5353, 53)
    assert other_domains(87, listed(tmp_path, *ports)) == [0, 42]


def test_ports_that_any_program_may_get_tell_nothing(tmp_path):
    assert other_domains(0, listed(tmp_path, 7400 + 250 * 120 + 10, 7401)) == []


def test_the_system_s_own_list_can_be_read():
    assert isinstance(other_domains(0), list)
