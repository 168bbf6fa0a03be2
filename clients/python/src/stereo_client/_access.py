"""Who a client is to a server, and whom it trusts: tokens and TLS."""

from __future__ import annotations

import os
import ssl
from dataclasses import dataclass
from typing import TypeAlias

from .errors import InputError

File: TypeAlias = "str | os.PathLike[str]"
Certificate: TypeAlias = "File | tuple[File, File]"
"""A PEM file with a certificate and its private key, or one with each."""


@dataclass(frozen=True)
class Access:
    """What servers ask of their clients, and what is asked of them."""

    token: str | None = None
    ca: File | None = None
    cert: Certificate | None = None

    def __post_init__(self) -> None:
        token = self.token
        is_token = isinstance(token, str) and token.isascii() and token.isprintable() and " " not in token
        if token is not None and not (is_token and token):
            raise InputError("the token has other characters than tokens have: give one as `stereod token` prints it")

    def __repr__(self) -> str:
        return f"Access(token={'...' if self.token else None}, ca={self.ca!r}, cert={self.cert!r})"

    def headers(self) -> dict[str, str]:
        """Return what goes with every request."""
        return {"Authorization": f"Bearer {self.token}"} if self.token else {}

    def context(self) -> ssl.SSLContext:
        """Return how TLS is spoken; blocks while files are read."""
        try:
            context = ssl.create_default_context(cafile=None if self.ca is None else os.fspath(self.ca))
        except (OSError, TypeError) as why:
            raise _unusable(
                "ca", self.ca, why, "give the PEM file of the authority that signed the server's certificate"
            ) from why
        context.set_alpn_protocols(["http/1.1"])
        if self.cert is not None:
            try:
                chain, key = self.cert if isinstance(self.cert, tuple) else (self.cert, None)
                context.load_cert_chain(os.fspath(chain), None if key is None else os.fspath(key), _no_password)
            except (OSError, TypeError, ValueError) as why:
                advice = "give a PEM file with the certificate and its key, or a tuple of one file each"
                raise _unusable("cert", self.cert, why, advice) from why
        return context


def _no_password() -> str:
    raise ValueError("its key has a password")


def _unusable(what: str, given: object, why: Exception, advice: str) -> InputError:
    reason = why.strerror if isinstance(why, OSError) and why.strerror else str(why)
    return InputError(f"{what} {given!r} can't be used ({reason}): {advice}")
