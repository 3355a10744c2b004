"""What there is to warn of in models and in delivered bodies."""

from morembs.examination.warnings import examined

__all__ = ["examined"]
