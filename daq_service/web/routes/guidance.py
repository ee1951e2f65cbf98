"""`/api/v1/guidance`: guidance for each kind of alarm."""

from __future__ import annotations

from dataclasses import asdict

from fastapi import APIRouter

from daq_service.alarms.guidance import GUIDANCE
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import GuidanceList

router = APIRouter(tags=["alarms"])


@router.get("/guidance", response_model=GuidanceList)
def list_guidance() -> JsonAnswer:
    """List for each kind of alarm its meaning, limitations, checks and contact."""
    return JsonAnswer({"items": [{"kind": kind, **asdict(guidance)} for kind, guidance in GUIDANCE.items()]})
