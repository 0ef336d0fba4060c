"""Events on real sockets: to a group, to a host, over TCP and over TLS."""

from __future__ import annotations

import os
import shutil
import socket
import ssl
import struct
import subprocess
import time
import uuid
from contextlib import closing
from functools import partial
from types import SimpleNamespace

import pytest
from link_peer import LONG_S, exactly, wait_for, without_pauses

from av_reports.cot.connection import check_address, connect
from av_reports.identifiers import node_uuid
from av_reports.link import Link

pytestmark = pytest.mark.system
GROUP = '239.77.3.1'
EVENT = b'<event/>'
IP_RECVTTL = 12  # of Linux; not in the module socket


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch):
    without_pauses(monkeypatch)


def to(url, client_cert='', client_key='', ca_file=''):
    """The parameters `cot` of the node."""
    return SimpleNamespace(url=url, client_cert=str(client_cert), client_key=str(client_key), ca_file=str(ca_file))


def opened(url):
    link = Link(partial(connect, to(url), '127.0.0.1'))
    wait_for(lambda: link.take().session)
    return closing(link)


def test_a_group_gets_datagrams_that_do_not_leave_the_network():
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as receiver:
        receiver.bind((GROUP, 0))
        receiver.setsockopt(socket.IPPROTO_IP, IP_RECVTTL, 1)
        membership = socket.inet_aton(GROUP) + socket.inet_aton('127.0.0.1')
        receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        receiver.settimeout(LONG_S)
        with opened(f'udp://{GROUP}:{receiver.getsockname()[1]}') as link:
            link.put([EVENT], 1)
            data, ancillary, _, _ = receiver.recvmsg(2000, 100)
            lives = [struct.unpack('i', value)[0] for _, kind, value in ancillary if kind == socket.IP_TTL]
            assert data == EVENT and lives == [1]


def test_a_host_gets_datagrams_and_its_absence_harms_nothing():
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as receiver:
        receiver.bind(('127.0.0.1', 0))
        receiver.settimeout(LONG_S)
        with opened(f'udp://127.0.0.1:{receiver.getsockname()[1]}') as link:
            link.put([EVENT], 1)
            assert receiver.recv(2000) == EVENT
            receiver.close()
            for _ in range(5):
                link.put([EVENT], link.take().session)
                time.sleep(0.1)
            wait_for(lambda: link.take().session)
            assert link._thread.is_alive()


def test_tcp_gets_a_stream_and_what_it_sends_is_thrown_away():
    server = socket.create_server(('127.0.0.1', 0))
    with server, opened(f'tcp://127.0.0.1:{server.getsockname()[1]}') as link:
        peer, _ = server.accept()
        peer.settimeout(LONG_S)
        peer.sendall(b'<event>' * 300_000)
        link.put([EVENT, EVENT], 1)
        assert exactly(peer, 2 * len(EVENT)) == 2 * EVENT and link.take().messages == []
        peer.close()
        wait_for(lambda: link.connections == 2)


@pytest.fixture(scope='module')
def keys(tmp_path_factory):
    """Certificates and keys of two authorities, each with one for 127.0.0.1, which serves as that of a client, too."""
    if shutil.which('openssl') is None:
        pytest.skip('needs openssl')
    folder = tmp_path_factory.mktemp('keys')

    environment = {name: value for name, value in os.environ.items() if name != 'LD_LIBRARY_PATH'}  # libraries of its own

    def openssl(*words):
        subprocess.run(['openssl', *words], cwd=folder, check=True, capture_output=True, env=environment)
    (folder / 'san').write_text('subjectAltName=IP:127.0.0.1')
    for name in ('own', 'other'):
        curve = ('-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:P-256', '-nodes', '-days', '2')
        openssl('req', '-x509', *curve, '-subj', f'/CN={name}', '-keyout', f'{name}_ca.key', '-out', f'{name}_ca.pem')
        openssl('req', *curve[:-2], '-subj', '/CN=127.0.0.1', '-keyout', f'{name}.key', '-out', f'{name}.csr')
        openssl('x509', '-req', '-in', f'{name}.csr', '-CA', f'{name}_ca.pem', '-CAkey', f'{name}_ca.key', '-CAcreateserial',
                '-days', '2', '-extfile', 'san', '-out', f'{name}.pem')
    return folder


def secured(keys, port, authority):
    return to(f'tls://127.0.0.1:{port}', keys / 'own.pem', keys / 'own.key', keys / f'{authority}_ca.pem')


@pytest.fixture
def tls_server(keys):
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(keys / 'own.pem', keys / 'own.key')
    context.load_verify_locations(keys / 'own_ca.pem')
    context.verify_mode = ssl.CERT_REQUIRED
    with socket.create_server(('127.0.0.1', 0)) as listener:
        listener.settimeout(LONG_S)
        yield listener, context


def test_tls_has_both_sides_show_their_certificates(keys, tls_server):
    listener, context = tls_server
    link = Link(partial(connect, secured(keys, listener.getsockname()[1], 'own')))
    with closing(link):
        plain, _ = listener.accept()
        with context.wrap_socket(plain, server_side=True) as peer:
            assert peer.getpeercert()['subject'] == ((('commonName', '127.0.0.1'),),)
            wait_for(lambda: link.take().session)
            link.put([EVENT], 1)
            assert exactly(peer, len(EVENT)) == EVENT


def test_a_server_of_another_authority_gets_nothing(keys, tls_server):
    listener, context = tls_server
    link = Link(partial(connect, secured(keys, listener.getsockname()[1], 'other')))
    with closing(link):
        plain, _ = listener.accept()
        with pytest.raises((ssl.SSLError, OSError)):
            context.wrap_socket(plain, server_side=True)
        wait_for(lambda: link.problem)
        assert link.connections == 0 and 'verify' in link.problem


@pytest.mark.parametrize('url', ['', 'udp', 'udp://', 'udp://host', 'http://host:1', 'file:///etc/passwd', 'tcp://host:x',
                                 'log://stdout:1', 'tcp://host:99999', 'udp+ro://239.2.3.1:6969', 'tcp://host:1/path'])
def test_other_addresses_are_refused(url):
    with pytest.raises(ValueError, match='expected udp://'):
        check_address(to(url))


def test_tls_needs_its_files(keys):
    address = secured(keys, 8089, 'own')
    check_address(address)
    address.client_key = 'nowhere.key'
    with pytest.raises(ValueError, match='cot.client_key'):
        check_address(address)


def test_a_node_keeps_the_uuid_it_has_drawn(tmp_path, monkeypatch):
    """Version 4, which is all that the middleware takes; another node has another one, and rubbish is named."""
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'home'))
    file, first = tmp_path / 'home' / 'av_reports' / 'left.report_node.uuid', node_uuid('/left/report_node')
    assert node_uuid('/left/report_node') == first == file.read_text().strip()
    assert uuid.UUID(first).version == 4 and uuid.UUID(first).variant == uuid.RFC_4122
    assert node_uuid('/right/report_node') != first and len(list(file.parent.iterdir())) == 2
    file.write_text(str(uuid.uuid5(uuid.NAMESPACE_DNS, 'rig')))
    with pytest.raises(ValueError, match='expected a UUID of version 4: delete the file'):
        node_uuid('/left/report_node')
