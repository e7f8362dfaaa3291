"""How far a result can be trusted: evidence that the search measures, rules that judge it, limits they judge by."""

from regtorch.registration.trust.evidence import Evidence
from regtorch.registration.trust.limits import LIMITS, Limits
from regtorch.registration.trust.rules import RULES, Reason, Rule, judge

__all__ = ["LIMITS", "RULES", "Evidence", "Limits", "Reason", "Rule", "judge"]
