"""Policies and keystores: what is permitted to whom, which files there are, and what is said of those that cannot be used."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory

from av_bringup.cli.security import main
from av_bringup.security.keystore import FILES, KeystoreError, OpensslError, check_enclave, openssl
from av_bringup.security.policy import read_policy

SHIPPED = Path(get_package_share_directory('av_bringup')) / 'config' / 'security'
POLICY = '''<policy version="0.2.0" xmlns:xi="http://www.w3.org/2001/XInclude"><enclaves><enclave path="/talker"><profiles>
<profile ns="/" node="talker"><topics publish="ALLOW" subscribe="ALLOW"><topic>chatter</topic><topic>/tf</topic></topics>
<services reply="ALLOW"><service>~/get</service></services><services request="ALLOW"><service>add</service></services>
</profile></profiles></enclave></enclaves></policy>'''


@pytest.fixture
def policy(tmp_path):
    file = tmp_path / 'policy.xml'
    file.write_text(POLICY)
    return file


@pytest.fixture
def keystore(tmp_path, policy):
    assert main(['--keystore', str(tmp_path / 'keys'), '--policy', str(policy)]) == 0
    return tmp_path / 'keys'


class TestPolicy:
    def test_topics_and_services_are_those_of_dds(self, policy):
        enclave, = read_policy(policy)
        assert enclave.path == '/talker'
        assert enclave.publish == ('ros_discovery_info', 'rq/addRequest', 'rr/talker/getReply', 'rt/chatter', 'rt/tf')
        assert enclave.subscribe == ('ros_discovery_info', 'rq/talker/getRequest', 'rr/addReply', 'rt/chatter', 'rt/tf')

    @pytest.mark.parametrize('namespace', ['rig1', '/rig1', '/rig1/'])
    def test_relative_names_follow_the_namespace_and_absolute_ones_do_not(self, policy, namespace):
        enclave, = read_policy(policy, namespace)
        assert enclave.path == '/rig1/talker'
        assert enclave.publish == ('ros_discovery_info', 'rq/rig1/addRequest', 'rr/rig1/talker/getReply', 'rt/rig1/chatter',
                                   'rt/tf')

    def test_only_one_node_of_a_live_rig_may_publish_bearings_and_one_commands(self):
        enclaves = [enclave for enclave in read_policy(SHIPPED / 'policy.xml') if enclave.path != '/player_node']
        for topic, node in (('rt/target/bearing', '/fusion_node'), ('rt/pointing/command', '/pointing_node')):
            assert [enclave.path for enclave in enclaves if topic in enclave.publish] == [node]

    @pytest.mark.parametrize(('old', 'new', 'complaint'), [
        ('publish="ALLOW"', 'publish="DENY"', 'not supported'), ('topics', 'actions', 'not supported'),
        ('"/talker"', '"/../talker"', "'/../talker'"), ('</policy>', '', 'no element found'),
        ('<enclave path', '<xi:include href="policy.xml" xpointer="other"/><enclave path', "'other'"),
        ('policy', 'enclaves', 'expected <policy>')])
    def test_what_is_wrong_with_a_file_is_said_with_its_name(self, policy, old, new, complaint):
        policy.write_text(POLICY.replace(old, new))
        with pytest.raises(ValueError, match=complaint) as error:
            read_policy(policy)
        assert str(error.value).startswith(str(policy))

    def test_a_policy_that_includes_itself_is_refused(self, policy):
        policy.write_text(POLICY.replace('<enclave path', '<xi:include href="policy.xml" xpointer="xpointer(/policy/*)"/>'
                                                          '<enclave path'))
        with pytest.raises(ValueError, match='includes'):
            read_policy(policy)

    @pytest.mark.parametrize('namespace', ['a b', '1', 'a/../b', '$x'])
    def test_a_namespace_is_a_name(self, policy, namespace):
        with pytest.raises(ValueError, match='namespace'):
            read_policy(policy, namespace)


class TestKeystore:
    def test_nobody_else_can_read_keys(self, keystore):
        keys = list(keystore.rglob('*key.pem'))
        assert len(keys) == 3
        assert not any(file.stat().st_mode & 0o077 for file in [keystore, *keys])

    def test_git_ignores_it(self, keystore):
        assert (keystore / '.gitignore').read_text() == '*\n'

    def test_renewal_keeps_the_authorities_and_other_enclaves(self, keystore, policy):
        before = {file: file.read_bytes() for file in keystore.rglob('*.pem')}
        assert main(['--keystore', str(keystore), '--policy', str(policy), '--namespace', 'rig1']) == 0
        assert all(file.read_bytes() == data for file, data in before.items())
        assert main(['--keystore', str(keystore), '--policy', str(policy)]) == 0
        changed = {str(file.relative_to(keystore)) for file, data in before.items() if file.read_bytes() != data}
        assert changed == {'enclaves/talker/cert.pem', 'enclaves/talker/key.pem'}
        for path in ('/talker', '/rig1/talker'):
            check_enclave(keystore, path)
        assert not list(keystore.rglob('.new-*'))

    @pytest.mark.parametrize('name', FILES)
    def test_a_missing_file_is_named(self, keystore, name):
        file = keystore / 'enclaves' / 'talker' / name
        file.unlink()
        with pytest.raises(KeystoreError, match=f'{re.escape(str(file))}: no such file'):
            check_enclave(keystore, '/talker')

    def test_a_key_that_others_can_read_is_refused(self, keystore):
        (keystore / 'enclaves/talker/key.pem').chmod(0o644)
        with pytest.raises(KeystoreError, match='enclaves/talker/key.pem may be read by everybody'):
            check_enclave(keystore, '/talker')

    def test_an_expired_certificate_is_named(self, keystore, policy):
        assert main(['--keystore', str(keystore), '--policy', str(policy), '--days', '-0.5']) == 0
        with pytest.raises(KeystoreError, match='enclaves/talker/cert.pem cannot be used: .*certificate has expired'):
            check_enclave(keystore, '/talker')

    def test_expired_permissions_are_named(self, keystore, policy):
        folder = keystore / 'enclaves/talker'
        valid = {name: (folder / name).read_bytes() for name in ('cert.pem', 'key.pem')}
        assert main(['--keystore', str(keystore), '--policy', str(policy), '--days', '-0.5']) == 0
        for name, data in valid.items():
            (folder / name).write_bytes(data)
        with pytest.raises(KeystoreError, match='enclaves/talker/permissions.p7s is valid from .* only'):
            check_enclave(keystore, '/talker')

    def test_a_certificate_of_another_authority_is_named(self, keystore, policy, tmp_path):
        assert main(['--keystore', str(tmp_path / 'other'), '--policy', str(policy)]) == 0
        for name in ('cert.pem', 'permissions.p7s'):
            file, foreign = (folder / 'enclaves/talker' / name for folder in (keystore, tmp_path / 'other'))
            own = file.read_bytes()
            file.write_bytes(foreign.read_bytes())
            with pytest.raises(KeystoreError, match=f'enclaves/talker/{name} cannot be used'):
                check_enclave(keystore, '/talker')
            file.write_bytes(own)

    def test_changed_permissions_are_refused(self, keystore):
        file = keystore / 'enclaves/talker/permissions.p7s'
        file.write_bytes(file.read_bytes().replace(b'rt/chatter', b'rt/anybody'))
        with pytest.raises(KeystoreError, match='enclaves/talker/permissions.p7s cannot be used'):
            check_enclave(keystore, '/talker')

    @pytest.mark.parametrize('arguments', [
        ['--policy', '/no/such.xml'], ['--namespace', 'a b'], ['--governance', '/no/such.xml'], ['--days', 'nan'],
        ['--days', '1e300'], ['--days', '9000']])
    def test_a_mistake_is_one_line_and_code_1(self, tmp_path, capsys, arguments):
        assert main(['--keystore', str(tmp_path / 'keys'), *arguments]) == 1
        assert len(capsys.readouterr().err.splitlines()) == 1

    def test_without_openssl_its_name_is_said(self, monkeypatch):
        monkeypatch.setenv('PATH', '')
        with pytest.raises(OpensslError, match='openssl is not installed'):
            openssl('version')
