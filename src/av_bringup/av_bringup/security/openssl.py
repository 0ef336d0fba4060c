"""Certificates and signatures by the program `openssl`."""

from __future__ import annotations

import os
import subprocess
import tempfile
from datetime import datetime
from pathlib import Path

CONFIGURATION = '''
[ca]
default_ca = issuer
[issuer]
database = {folder}/index.txt
new_certs_dir = {folder}
rand_serial = yes
unique_subject = no
default_md = sha256
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
    openssl('genpkey', '-algorithm', 'EC', '-pkeyopt', 'ec_paramgen_curve:P-256', '-out', key)
    with tempfile.TemporaryDirectory() as folder:
        configuration, request = Path(folder, 'openssl.cnf'), Path(folder, 'request.pem')
        configuration.write_text(CONFIGURATION.format(folder=folder, name=name))
        Path(folder, 'index.txt').touch()
        openssl('req', '-new', '-config', configuration, '-key', key, '-out', request)
        signer: list[str | Path] = ['-cert', authority[0], '-keyfile', authority[1], '-extensions', 'node'] if authority else \
            ['-selfsign', '-keyfile', key, '-extensions', 'authority']
        first, last = (f'{time:%Y%m%d%H%M%SZ}' for time in validity)
        openssl('ca', '-batch', '-notext', '-config', configuration, *signer, '-startdate', first, '-enddate', last,
                '-in', request, '-out', certificate)


def sign(document: Path, signed: Path, authority: tuple[Path, Path]) -> None:
    """Write a document with its signature, as S/MIME in clear text. Raises OpensslError.

    Parameters:
        document: file to sign
        signed: file to write
        authority: certificate and private key that sign
    """
    openssl('smime', '-sign', '-text', '-in', document, '-out', signed, '-signer', authority[0], '-inkey', authority[1])
