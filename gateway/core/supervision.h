/* Heartbeats of the drives' nodes (CiA 301). */
#ifndef TRACTION_SUPERVISION_H
#define TRACTION_SUPERVISION_H

#include "gateway/core/records.h"

/* A frame with the heartbeat's identifier of a node, an index into `nodes`. length: of its data, of
 * which `byte` is the first; plain: 1 if it is neither FD nor remote. One of a wrong format is
 * counted only. */
void on_heartbeat(struct supervision *all, int32_t node, int64_t t_ns, int32_t length,
                  int32_t plain, int32_t byte);

/* A remote frame: with a node's heartbeat identifier it is a node-guard request to it. */
void on_node_guard(struct supervision *all, uint32_t can_id);

/* 1 if a node, an index into `nodes`, is supervised and silent for longer than its time-out. */
int is_node_lost(const struct supervision *all, int32_t node, int64_t now_ns);

#endif
