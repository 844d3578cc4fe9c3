#include "shim.h"

#include <string.h>

_Static_assert(offsetof(struct EmbreeQuery, context) == 0, "a context must turn back into its query");
_Static_assert(RTC_MAX_INSTANCE_LEVEL_COUNT == 1, "whit's packets hold one instance level: use Embree as Debian builds it");

/* The rows of a packet that whit's own packet repeats; what is behind them differs between versions. */
#define ROW(field) offsetof(struct RTCRayHit16, field) / sizeof(float[16])
_Static_assert(ROW(ray.org_x) == 0 && ROW(ray.tnear) == 3 && ROW(ray.dir_x) == 4 && ROW(ray.time) == 7, "ray rows");
_Static_assert(ROW(ray.tfar) == 8 && ROW(ray.mask) == 9 && ROW(ray.id) == 10 && ROW(ray.flags) == 11, "ray rows");
_Static_assert(ROW(hit.Ng_x) == 12 && ROW(hit.u) == 15 && ROW(hit.v) == 16, "hit rows");
_Static_assert(ROW(hit.primID) == 17 && ROW(hit.geomID) == 18 && ROW(hit.instID) == 19, "hit rows");

void embree_query_init(struct EmbreeQuery *query, int coherent) {
#if EMBREE_SYS_API == 4
  rtcInitRayQueryContext(&query->context);
  rtcInitIntersectArguments(&query->intersect);
  rtcInitOccludedArguments(&query->occluded);
  query->intersect.flags = coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
  query->occluded.flags = query->intersect.flags;
#else
  rtcInitIntersectContext(&query->context);
  query->context.flags = coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
#endif
}

#if EMBREE_SYS_API == 4
/* The arguments point at the context only for the length of a call, because the query may have moved since the last. */
static struct RTCIntersectArguments *intersect_arguments(struct EmbreeQuery *query) {
  query->intersect.context = &query->context;
  return &query->intersect;
}

static struct RTCOccludedArguments *occluded_arguments(struct EmbreeQuery *query) {
  query->occluded.context = &query->context;
  return &query->occluded;
}
#endif

void embree_intersect1(RTCScene scene, struct EmbreeQuery *query, struct RTCRayHit *rays) {
#if EMBREE_SYS_API == 4
  rtcIntersect1(scene, rays, intersect_arguments(query));
#else
  rtcIntersect1(scene, &query->context, rays);
#endif
}

void embree_occluded1(RTCScene scene, struct EmbreeQuery *query, struct RTCRay *rays) {
#if EMBREE_SYS_API == 4
  rtcOccluded1(scene, rays, occluded_arguments(query));
#else
  rtcOccluded1(scene, &query->context, rays);
#endif
}

#if EMBREE_SYS_API == 4
#define PACKET_CALLS(N)                                                                                                \
  void embree_intersect##N(const int *valid, RTCScene scene, struct EmbreeQuery *query, struct RTCRayHit##N *rays) {   \
    rtcIntersect##N(valid, scene, rays, intersect_arguments(query));                                                   \
  }                                                                                                                    \
  void embree_occluded##N(const int *valid, RTCScene scene, struct EmbreeQuery *query, struct RTCRay##N *rays) {       \
    rtcOccluded##N(valid, scene, rays, occluded_arguments(query));                                                     \
  }
#else
#define PACKET_CALLS(N)                                                                                                \
  void embree_intersect##N(const int *valid, RTCScene scene, struct EmbreeQuery *query, struct RTCRayHit##N *rays) {   \
    rtcIntersect##N(valid, scene, &query->context, rays);                                                              \
  }                                                                                                                    \
  void embree_occluded##N(const int *valid, RTCScene scene, struct EmbreeQuery *query, struct RTCRay##N *rays) {       \
    rtcOccluded##N(valid, scene, &query->context, rays);                                                               \
  }
#endif

PACKET_CALLS(4)
PACKET_CALLS(8)
PACKET_CALLS(16)

void embree_report_lanes(int *valid, const int *hit, unsigned int count) {
#if EMBREE_SYS_API == 4
  memcpy(valid, hit, count * sizeof *valid);
#else
  (void)valid, (void)hit, (void)count;
#endif
}
