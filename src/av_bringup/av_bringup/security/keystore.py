"""Keystores as SROS 2 lays them out: two authorities, and the key, certificate and permissions of each enclave.

public/     certificates of the authorities
private/    their keys: not needed to run a rig, keep them elsewhere
enclaves/   what the nodes read, a folder for each
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime, timedelta, timezone
from pathlib import Path
from xml.etree import ElementTree as ET
from xml.etree.ElementTree import Element, SubElement

from av_bringup.security.policy import Enclave

AUTHORITIES = ('identity_ca', 'permissions_ca')
AUTHORITY_DAYS = 3650  # ten years, longer than any of its certificates
CLOCK_TOLERANCE = timedelta(days=1)  # a vehicle's clock may be late at start-up
SCHEMA = 'http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_permissions.xsd'
DOMAINS = (0, 230)  # of DDS, whose ports end at 232 (DDSI-RTPS 2.5, 9.6)
# What Cyclone DDS and Fast DDS read of an enclave, as `ros2 security` names it.
FILES = ('identity_ca.cert.pem', 'cert.pem', 'key.pem', 'permissions_ca.cert.pem', 'governance.p7s', 'permissions.p7s')
CONFIGURATION = '''
[issuer]
database = {folder}/index.txt
rand_serial = yes
policy = subject
[subject]
commonName = supplied
[req]
distinguished_name = name
prompt = no
string_mask = utf8only
[name]
CN = {name}
[authority]
basicConstraints = critical, CA:true, pathlen:1
[node]
basicConstraints = CA:false
'''


class OpensslError(ValueError):
    """The program `openssl` is missing, or refused what it was given."""


def openssl(*arguments: str | Path) -> str:
    """Output of `openssl ARGUMENTS`; what it writes can be read by this user only. Raises OpensslError."""
    # ROS brings a libssl of its own, with which the system's program does not start.
    environment = {name: value for name, value in os.environ.items() if name != 'LD_LIBRARY_PATH'}
    try:
        run = subprocess.run(['openssl', *map(str, arguments)], text=True, capture_output=True, check=False, env=environment,
                             umask=0o077)
    except FileNotFoundError as error:
        raise OpensslError('the program openssl is not installed') from error
    if run.returncode:
        raise OpensslError(' '.join(run.stderr.split()) or f'openssl {arguments[0]} failed')
    return run.stdout


def make_certificate(name: str, key: Path, certificate: Path, validity: tuple[datetime, datetime],
                     authority: tuple[Path, Path] | None = None) -> None:
    """A new private key (P-256, as DDS Security asks) and its certificate. Raises OpensslError.

    Parameters:
        name: common name of the subject
        key: file for the private key
        certificate: file for the certificate
        validity: first and last time of its validity, UTC
        authority: certificate and private key of the authority that signs it; None makes a new authority
    """
    with tempfile.TemporaryDirectory() as folder:
        configuration, request = Path(folder, 'openssl.cnf'), Path(folder, 'request.pem')
        configuration.write_text(CONFIGURATION.format(folder=folder, name=name))
        Path(folder, 'index.txt').touch()
        openssl('req', '-config', configuration, '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:P-256', '-nodes',
                '-keyout', key, '-out', request)
        signer: list[str | Path] = ['-cert', authority[0], '-keyfile', authority[1], '-extensions', 'node'] if authority else \
            ['-selfsign', '-keyfile', key, '-extensions', 'authority']
        first, last = (f'{time:%Y%m%d%H%M%SZ}' for time in validity)
        openssl('ca', '-batch', '-notext', '-config', configuration, '-name', 'issuer', '-md', 'sha256', *signer,
                '-startdate', first, '-enddate', last, '-outdir', folder, '-in', request, '-out', certificate)


def sign(document: Path, signed: Path, authority: tuple[Path, Path]) -> None:
    """Write a document with its signature, as S/MIME in clear text. Raises OpensslError.

    Parameters:
        document: file to sign
        signed: file to write
        authority: certificate and private key that sign
    """
    openssl('smime', '-sign', '-text', '-in', document, '-out', signed, '-signer', authority[0], '-inkey', authority[1])


class KeystoreError(ValueError):
    """A keystore that cannot be used; the message names the file and the reason."""


def make_keystore(keystore: Path, enclaves: Sequence[Enclave], governance: Path, days: float = 365.0) -> None:
    """Make a keystore, or renew the enclaves of one: new keys, certificates and permissions by the same authorities.

    Enclaves that are not named stay as they are.

    Parameters:
        keystore: its folder, for this user only
        enclaves: the enclaves to make
        governance: what DDS protects, and how
        days: validity of certificates and permissions

    Raises ValueError, OpensslError or OSError.
    """
    if not abs(days) <= AUTHORITY_DAYS:
        raise ValueError(f'days is {days}, expected at most {AUTHORITY_DAYS}, which is the validity of the authorities')
    now = datetime.now(timezone.utc)
    for folder in (keystore, *(keystore / name for name in ('public', 'private', 'enclaves'))):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    keystore.chmod(0o700)
    (keystore / '.gitignore').write_text('*\n')
    for name in AUTHORITIES:
        certificate, key = _authority(keystore, name)
        if not (certificate.exists() and key.exists()):
            with _replacing(certificate, key) as (new_certificate, new_key):
                make_certificate(name, new_key, new_certificate, (now - CLOCK_TOLERANCE, now + timedelta(AUTHORITY_DAYS)))
    with _replacing(keystore / 'enclaves' / 'governance.p7s') as (signed,):
        sign(governance, signed, _authority(keystore, 'permissions_ca'))
    for enclave in enclaves:
        _make_enclave(keystore, enclave, (now - CLOCK_TOLERANCE, now + timedelta(days)))


def check_enclave(keystore: Path, path: str) -> None:
    """Raise KeystoreError unless a node can start in an enclave now: files, signatures, validity, and privacy of its key.

    Parameters:
        keystore: the keystore's folder
        path: the enclave's name, such as `/rig1/fusion_node`
    """
    folder = _folder(keystore, path)
    for name in FILES:
        if not (folder / name).is_file():
            raise KeystoreError(f'{folder / name}: no such file, expected one made by `ros2 run av_bringup security`')
    if (folder / 'key.pem').stat().st_mode & 0o007:
        raise KeystoreError(f'{folder / "key.pem"} may be read by everybody, `chmod 600` it')
    _verified(folder / 'cert.pem', 'verify', '-CAfile', folder / 'identity_ca.cert.pem', folder / 'cert.pem')
    for name in ('governance.p7s', 'permissions.p7s'):
        document = _verified(folder / name, 'smime', '-verify', '-text', '-CAfile', folder / 'permissions_ca.cert.pem',
                             '-in', folder / name)
    validity = ET.fromstring(document).find('.//validity')  # of the last of the two
    first, last = ('' if validity is None else validity.findtext(name, '') for name in ('not_before', 'not_after'))
    if not first <= datetime.now(timezone.utc).isoformat() <= last:
        raise KeystoreError(f'{folder / "permissions.p7s"} is valid from {first} to {last} only')


def permissions(enclave: Enclave, validity: tuple[datetime, datetime]) -> bytes:
    """The permissions document of an enclave.

    Parameters:
        enclave: what is permitted; all else is denied
        validity: first and last time of its validity, UTC
    """
    document = Element('dds', {'xmlns:xsi': 'http://www.w3.org/2001/XMLSchema-instance',
                               'xsi:noNamespaceSchemaLocation': SCHEMA})
    grant = SubElement(SubElement(document, 'permissions'), 'grant', name=enclave.path)
    SubElement(grant, 'subject_name').text = f'CN={enclave.path}'
    period = SubElement(grant, 'validity')
    for name, time in zip(('not_before', 'not_after'), validity, strict=True):
        SubElement(period, name).text = f'{time:%Y-%m-%dT%H:%M:%S}'
    rule = SubElement(grant, 'allow_rule')
    domains = SubElement(SubElement(rule, 'domains'), 'id_range')
    for name, number in zip(('min', 'max'), DOMAINS, strict=True):
        SubElement(domains, name).text = str(number)
    for name, expressions in (('publish', enclave.publish), ('subscribe', enclave.subscribe)):
        topics = SubElement(SubElement(rule, name), 'topics')
        for expression in expressions:
            SubElement(topics, 'topic').text = expression
    SubElement(grant, 'default').text = 'DENY'
    ET.indent(document)
    return ET.tostring(document, encoding='utf-8', xml_declaration=True)


def _make_enclave(keystore: Path, enclave: Enclave, validity: tuple[datetime, datetime]) -> None:
    folder = _folder(keystore, enclave.path)
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    for link, target in (('identity_ca.cert.pem', keystore / 'public' / 'identity_ca.cert.pem'),
                         ('permissions_ca.cert.pem', keystore / 'public' / 'permissions_ca.cert.pem'),
                         ('governance.p7s', keystore / 'enclaves' / 'governance.p7s')):
        if not (folder / link).is_symlink():
            (folder / link).symlink_to(os.path.relpath(target, folder))
    with _replacing(*(folder / name for name in ('cert.pem', 'key.pem', 'permissions.xml', 'permissions.p7s'))) as \
            (certificate, key, document, signed):
        make_certificate(enclave.path, key, certificate, validity, _authority(keystore, 'identity_ca'))
        document.write_bytes(permissions(enclave, validity))
        sign(document, signed, _authority(keystore, 'permissions_ca'))


@contextmanager
def _replacing(*files: Path) -> Iterator[list[Path]]:
    """Files to write, in a folder of this user; they replace those named when all are made."""
    with tempfile.TemporaryDirectory(dir=files[0].parent, prefix='.new-') as folder:
        new = [Path(folder, file.name) for file in files]
        yield new
        for made, file in zip(new, files, strict=True):
            made.replace(file)


def _folder(keystore: Path, path: str) -> Path:
    return keystore / 'enclaves' / path.lstrip('/')


def _authority(keystore: Path, name: str) -> tuple[Path, Path]:
    """Certificate and private key of an authority."""
    return keystore / 'public' / f'{name}.cert.pem', keystore / 'private' / f'{name}.key.pem'


def _verified(file: Path, *command: str | Path) -> str:
    """Output of an openssl command that checks a file. Raises KeystoreError that names the file."""
    try:
        return openssl(*command)
    except OpensslError as error:
        raise KeystoreError(f'{file} cannot be used: {error}') from error
