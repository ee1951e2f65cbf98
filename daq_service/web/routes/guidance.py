"""`/api/v1/guidance`: what to do about each kind of alarm."""

from __future__ import annotations

from dataclasses import asdict

from fastapi import APIRouter

from daq_service.alarms.guidance import GUIDANCE
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import GuidanceList

router = APIRouter(tags=["alarms"])


@router.get("/guidance", operation_id="list_guidance", response_model=GuidanceList)
def list_guidance() -> JsonAnswer:
    """Tell of each kind of alarm what it says, what it does not, where to look and whom to call."""
    return JsonAnswer({"items": [{"kind": kind, **asdict(one)} for kind, one in GUIDANCE.items()]})
