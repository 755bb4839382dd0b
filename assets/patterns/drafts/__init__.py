"""The project's own drafts: patterns for any body that can be measured."""

from assets.patterns.drafts.draft_registry import DRAFTS, DraftParameter, draft, draft_parameters

__all__ = ["DRAFTS", "DraftParameter", "draft", "draft_parameters"]
