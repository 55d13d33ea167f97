/* Heartbeats of the drives' nodes (CiA 301). */
#ifndef TRACTION_SUPERVISION_H
#define TRACTION_SUPERVISION_H

#include "gateway/core/records.h"

/* Receive a frame with the heartbeat identifier of a node, an index into `nodes`. length: of its
 * data, of which `byte` is the first; plain: 1 if it is neither FD nor remote. A frame of a wrong
 * format is only counted. */
void on_heartbeat(struct supervision *all, int32_t node, int64_t t_ns, int32_t length,
                  int32_t plain, int32_t byte);

/* Receive a remote frame: with a node's heartbeat identifier it is a node-guard request. */
void on_node_guard(struct supervision *all, uint32_t can_id);

/* 1 if a node, an index into `nodes`, is supervised and silent for longer than its time-out. */
int is_node_lost(const struct supervision *all, int32_t node, int64_t now_ns);

#endif
