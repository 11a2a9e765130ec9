"""Certificates made for one test by the openssl command, gone with it."""

import subprocess
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Signed:
    """A certificate and its key."""

    certificate: Path
    key: Path


class Authority:
    """Signs certificates for a device at an address, or for a client."""

    def __init__(self, folder, name):
        self.folder, self.name = folder, name
        self.ca = folder / f"{name}.pem"
        self.key = self._new_key(name)
        openssl("req", "-x509", "-new", "-key", self.key, "-subj", f"/CN={name}", "-days", "2", "-out", self.ca)

    def sign(self, name, *, address=None, days=2):
        key, request, certificate = self._new_key(name), self.folder / f"{name}.csr", self.folder / f"{name}.pem"
        extension = self.folder / f"{name}.ext"
        extension.write_text(f"subjectAltName={address}\n" if address else "basicConstraints=CA:FALSE\n")
        openssl("req", "-new", "-key", key, "-subj", f"/CN={name}", "-out", request)
        issue = ("-CA", self.ca, "-CAkey", self.key, "-CAcreateserial", "-days", str(days), "-extfile", extension)
        openssl("x509", "-req", "-in", request, *issue, "-out", certificate)
        return Signed(certificate, key)

    def _new_key(self, name):
        path = self.folder / f"{name}.key"
        openssl("ecparam", "-name", "prime256v1", "-genkey", "-noout", "-out", path)
        path.chmod(0o600)
        return path


def openssl(*arguments):
    """One command."""
    subprocess.run(["openssl", *map(str, arguments)], check=True, capture_output=True)
