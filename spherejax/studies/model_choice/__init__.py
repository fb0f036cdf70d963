"""Which of several models has made some records: `sj.compare_models`.

fits of all candidates      `comparing`: draws over the ranges (`search`), then local fits of the best of them
criterion, held-out score   `evidence`: of residuals that are whitened by one common process
what they come to           `choice_result`: which are told apart, in words
"""

from spherejax.studies.model_choice.candidate import Candidate
from spherejax.studies.model_choice.choice_result import ModelComparison, ModelEvidence
from spherejax.studies.model_choice.comparing import compare_models

__all__ = ["Candidate", "ModelComparison", "ModelEvidence", "compare_models"]
