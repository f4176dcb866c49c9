"""An iterate of the refinement with its certificate and its errors."""

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from linkplan.planner.refinement.case import Case, CertificateT, ErrorReport, Iterate, MotionT
from linkplan.planner.refinement.history import amend_last_step


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class CertifiedIterate(Generic[MotionT, CertificateT]):
    """An iterate, its certificate, and the errors that this shows; None without a certificate."""

    found: Iterate[MotionT]
    certificate: CertificateT | None
    report: ErrorReport | None

    @property
    def passed(self) -> bool:
        """True if its certificate passes."""
        return self.certificate is not None and self.certificate.passed

    @property
    def overruns(self) -> bool:
        """True if a limit is overrun between the nodes."""
        return self.report is not None and self.report.overruns

    @property
    def n_intervals(self) -> int:
        """The number of intervals of its mesh."""
        return self.found.mesh.n_intervals


CertifiedIterateT = TypeVar("CertifiedIterateT", bound=CertifiedIterate)


def certify_iterate(case: Case[MotionT, CertificateT], found: Iterate[MotionT]) -> CertifiedIterate[MotionT, CertificateT]:
    """Certify an iterate and note its integration error in the history."""
    certificate = case.certify(found.motion)
    report = None if certificate is None else case.error_report(certificate)
    if report is not None:
        amend_last_step(
            integration_error_deg=report.integration_error_deg,
            integration_error=report.integration_error,
        )
    return CertifiedIterate(found=found, certificate=certificate, report=report)


def error_of(at: CertifiedIterate[Any, Any]) -> float:
    """Return the integration error in its client's unit; infinite without a certificate."""
    return np.inf if at.report is None else at.report.integration_error_deg or at.report.integration_error or 0.0
