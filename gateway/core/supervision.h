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

/* Fill lost (node_count): 1 where a supervised node has been silent for longer than its time-out. */
void find_lost_nodes(const struct supervision *all, int64_t now_ns, uint8_t *lost);

#endif
