"""What was found with its certificate, and what that says to refinement."""

from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np

from linkplan.planner.refinement.case import Case, CertificateT, Findings, Found, MotionT
from linkplan.planner.refinement.history import Step


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Judged(Generic[MotionT, CertificateT]):
    """What was found, its certificate, and what that says; None where it has none."""

    found: Found[MotionT]
    certificate: CertificateT | None
    findings: Findings | None

    @property
    def passed(self) -> bool:
        """Whether its certificate passes."""
        return self.certificate is not None and self.certificate.passed

    @property
    def overruns(self) -> bool:
        """Whether a limit is overrun between the nodes."""
        return self.findings is not None and self.findings.overruns

    @property
    def n_intervals(self) -> int:
        """Of its mesh."""
        return self.found.mesh.n_intervals


JudgedT = TypeVar("JudgedT", bound=Judged)


def judged(case: Case[MotionT, CertificateT], found: Found[MotionT], history: list[Step]) -> Judged[MotionT, CertificateT]:
    """Return what was found with its certificate, whose error is noted in the history."""
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
