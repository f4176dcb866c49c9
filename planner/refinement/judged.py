"""An iterate of the refinement with its certificate and its errors."""

from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np

from linkplan.planner.refinement.case import Case, CertificateT, Findings, Found, MotionT
from linkplan.planner.refinement.history import Step


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Judged(Generic[MotionT, CertificateT]):
    """An iterate, its certificate, and the errors that this shows; None without a certificate."""

    found: Found[MotionT]
    certificate: CertificateT | None
    findings: Findings | None

    @property
    def passed(self) -> bool:
        """True if its certificate passes."""
        return self.certificate is not None and self.certificate.passed

    @property
    def overruns(self) -> bool:
        """True if a limit is overrun between the nodes."""
        return self.findings is not None and self.findings.overruns

    @property
    def n_intervals(self) -> int:
        """The number of intervals of its mesh."""
        return self.found.mesh.n_intervals


JudgedT = TypeVar("JudgedT", bound=Judged)


def judged(case: Case[MotionT, CertificateT], found: Found[MotionT], history: list[Step]) -> Judged[MotionT, CertificateT]:
    """Certify an iterate and note its integration error in the history."""
    certificate = case.certify(found.motion)
    findings = None if certificate is None else case.findings(certificate)
    if findings is not None:
        history[-1] = replace(
            history[-1],
            integration_error_deg=findings.integration_error_deg,
            integration_error=findings.integration_error,
        )
    return Judged(found=found, certificate=certificate, findings=findings)


def error_of(at: Judged[Any, Any]) -> float:
    """Return the integration error in its client's unit; infinite without a certificate."""
    return np.inf if at.findings is None else at.findings.integration_error_deg or at.findings.integration_error or 0.0
