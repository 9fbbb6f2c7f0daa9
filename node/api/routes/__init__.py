"""The routes, one module for each resource."""

from __future__ import annotations

from node.api.routes import (
    announcements,
    blocks,
    contracts,
    event_pages,
    events,
    explorer,
    finality,
    genesis,
    notices,
    openapi,
    proofs,
    queries,
    sessions,
    transactions,
)
from node.api.routes.custody import backgrounds, clips, consent_receipts, shares
from node.api.routing import Route

ROUTES: tuple[Route, ...] = (
    *genesis.ROUTES,
    *openapi.ROUTES,
    *transactions.ROUTES,
    *sessions.ROUTES,
    *finality.ROUTES,
    *proofs.ROUTES,
    *notices.ROUTES,
    *consent_receipts.ROUTES,
    *queries.ROUTES,
    *announcements.ROUTES,
    *events.ROUTES,
    *event_pages.ROUTES,
    *clips.ROUTES,
    *shares.ROUTES,
    *backgrounds.ROUTES,
    *blocks.ROUTES,
    *contracts.ROUTES,
    *explorer.ROUTES,
)
